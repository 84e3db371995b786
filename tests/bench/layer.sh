#!/bin/sh
# The layer against the package: first results and memory of a process that starts, with nothing in any cache and after
# that, then times of networks and dispatches of small graphs by layer_bench. Prints Markdown; two minutes on two cores
# once the driver's cache has the fast kernels.
#
#   tests/bench/layer.sh [BUILD_FOLDER]
set -eu
cd "$(dirname "$0")/../.."
build=$(cd "${1:-build}" && pwd)
models="models/nss_v1_high models/nss_v0_1"
# shellcheck disable=SC2086
python3 - "$build" $models <<'END'
import json, os, resource, subprocess, sys, tempfile
build, models = sys.argv[1], sys.argv[2:]
print("| network | by | caches | ready, ms | first run, ms | process, MB |")
print("|---|---|---|---:|---:|---:|")
for model in models:
    for way in ("layer", "package"):
        with tempfile.TemporaryDirectory() as folder:
            environment = dict(os.environ, MESA_SHADER_CACHE_DIR=folder + "/mesa", SHALE_LAYER_CACHE=folder + "/layer")
            command = [build + "/tools/shale", "run", model, "--render", "960x540", "--random", "1", "--json"]
            if way == "layer":
                environment.update(VK_LAYER_PATH=build + "/tools/layer", VK_INSTANCE_LAYERS="VK_LAYER_SHALE_data_graph")
                command.append("--native")
            else:
                command += ["--expected-runs", "100000"]
            for caches in ("empty", "filled"):
                process = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment)
                start = json.loads(process.stdout.read())["start"]
                _, status, usage = os.wait4(process.pid, 0)
                if status: sys.exit("shale run failed")
                print("| %s | %s | %s | %.0f | %.0f | %.0f |" % (os.path.basename(model), way, caches, start["create_ms"],
                      start["first_ms"], usage.ru_maxrss / 1000))
END
echo
echo "Ready: pipeline, session, weights; with nothing in the layer's cache it compiles the graph, which a package is already."
echo
# The first run compiles, and leaves the driver's disk cache.
# shellcheck disable=SC2086
"$build/tests/bench/layer_bench" $models --render 960x540 --repeat 1 >/dev/null
# shellcheck disable=SC2086
"$build/tests/bench/layer_bench" $models --render 960x540 --repeat 15
