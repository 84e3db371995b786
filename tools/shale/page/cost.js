"use strict";
(() => {
  const { data, main, colours, at, element, table, chart, group, dim, marker, start } = page;
  const files = data.files.map((file, i) => ({ ...file, pointer: "/files/" + i, title: file.model ?? file.file }));
  const models = files.filter((file) => file.modelled);

  if (models.length) {
    const device = models[0].modelled.device;
    const pointer = models[0].pointer + "/modelled/device";
    dim(`Modelled on ${device.name}: ${device.help}. Time of a dispatch: the longer of its arithmetic and its memory traffic, and the launch; energy is an estimate.`);
    const details = element("details");
    element("summary", "The model's constants and their sources", details);
    const rows = Object.keys(device).flatMap((key) =>
      device[key].source !== undefined ? [pointer + "/" + key]
        : typeof device[key] === "object" ? Object.keys(device[key]).map((part) => pointer + "/" + key + "/" + part) : []);
    table([{ title: "value", at: "/value", digits: 4 }, { title: "unit", at: "/unit" }, { title: "source", at: "/source" }], rows, details);
    [...details.querySelectorAll("tbody tr")].forEach((tr, i) => {
      const name = document.createElement("td");
      name.textContent = rows[i].slice(pointer.length + 1).replace("/", " ");
      tr.prepend(name);
    });
    details.querySelector("thead tr").prepend(document.createElement("th"));
  }

  element("h2", "All");
  table([
    { title: "file", at: "/file" }, { title: "parameters", at: "/parameters", digits: 0 },
    { title: "work", unit: "GOP", at: "/gop", digits: 3 },
    { title: "network", unit: "ms, modelled", at: "/modelled/time_ms", digits: 3 },
    { title: "memory", unit: "MB", at: "/modelled/memory_mb", digits: 1 },
    { title: "energy", unit: "mJ, estimate", at: "/modelled/energy_mj", digits: 2 },
    { title: "arena", unit: "MiB", at: "/modelled/arena_bytes", digits: 2, scale: 1 / 1048576 },
    { title: "passes", unit: "ms", at: "/frame/passes_ms", digits: 2 },
    { title: "frame", unit: "ms", at: "/frame/total_ms", digits: 2 },
    { title: "fits", at: "/frame/fits" },
    { title: "needs", unit: "TOP/s", at: "/frame/needs/tops", digits: 2 },
    { title: "predicted", unit: "us, package", at: "/time_us", digits: 0 },
    { title: "measured", unit: "us, package", at: "/measured_us", digits: 0 },
  ], files.map((file) => file.pointer));

  if (data.comparison) {
    element("h2", "The second against the first");
    const change = data.comparison.first_change;
    dim(change ? `First change: ${change.where}: ${change.what}: was ${change.before}, is ${change.after}` : "Nothing changed.");
    const totals = Object.keys(data.comparison.totals ?? {});
    table([{ title: "before", at: "/before", digits: 3 }, { title: "after", at: "/after", digits: 3 }, { title: "change", unit: "%", at: "/change", digits: 1, scale: 100 }],
      totals.map((name) => "/comparison/totals/" + name));
    [...main.lastElementChild.querySelectorAll("tbody tr")].forEach((tr, i) => tr.prepend(Object.assign(document.createElement("td"), { textContent: totals[i] })));
    main.lastElementChild.querySelector("thead tr")?.prepend(document.createElement("th"));
  }

  const framed = files.filter((file) => file.frame);
  if (framed.length) {
    const budget = framed.find((file) => file.modelled)?.frame.frame_ms;
    const box = chart(group(), "The frame, ms: passes and network against the budget", () => ({
      type: "bar",
      data: {
        labels: framed.map((file) => file.title),
        datasets: [
          { label: "passes", data: framed.map((file) => file.frame.passes_ms), backgroundColor: colours[7] },
          { label: "network", data: framed.map((file) => file.frame.network_ms), backgroundColor: colours[0] },
        ],
      },
      options: { indexAxis: "y", scales: { x: { stacked: true, beginAtZero: true, suggestedMax: budget }, y: { stacked: true } } },
      plugins: budget ? [marker("x", budget, "budget")] : [],
    }));
    box.style.height = 120 + 34 * framed.length + "px";
  }

  const bars = (title, labels, series, unit, stacked) => ({
    title, config: () => ({
      type: "bar",
      data: { labels, datasets: series },
      options: { scales: { x: { stacked, ticks: { autoSkip: false, maxRotation: 90 } }, y: { stacked, beginAtZero: true, title: { display: true, text: unit } } } },
    }),
  });
  const show = (parent, { title, config }) => chart(parent, title, config);

  for (const file of models) {
    const { modelled } = file;
    const rows = modelled.dispatches;
    const labels = rows.map((row) => row.name);
    element("h2", file.title);
    dim(`${file.file}${file.render ? `, ${file.render.join("x")} to ${file.output.join("x")}` : ""}`);
    if (file.fits) {
      const size = (pair) => pair ? pair.join("x") : "none";
      dim(`Largest result that fits the budget at ratio ${file.fits.ratio}: ${size(file.fits.largest_output)}; least ratio that fits at ${size(file.fits.output)}: ${file.fits.least_ratio ?? "none"}.`);
    }
    const place = group();
    const bound = (kind) => rows.map((row) => (row.bound === kind ? row.time_us - row.dispatch_us : 0));
    show(place, bars("Time by dispatch, us", labels, [
      { label: "arithmetic-bound", data: bound("compute"), backgroundColor: colours[0] },
      { label: "memory-bound", data: bound("memory"), backgroundColor: colours[1] },
      { label: "launch", data: rows.map((row) => row.dispatch_us), backgroundColor: colours[7] },
    ], "us", true));
    const device = modelled.device;
    const peak = device.tops.value * device.efficiency.value, memory = device.memory_gbps.value;
    const points = rows.filter((row) => row.ops_per_byte > 0 && row.time_us > 0)
      .map((row) => ({ x: row.ops_per_byte, y: 1e-6 * (2 * row.macs + row.ops) / row.time_us, name: row.name }));
    const left = Math.min(1, ...points.map((point) => point.x)), right = Math.max(10000, ...points.map((point) => point.x));
    const ridge = 1e3 * peak / memory;
    chart(place, "Roofline: TOP/s over operations a byte of memory", () => ({
      type: "scatter",
      data: {
        datasets: [
          { label: "dispatches", data: points, backgroundColor: colours[0], pointRadius: 5 },
          { label: "roof at int8 and the assumed efficiency", type: "line", showLine: true, pointRadius: 0, borderColor: colours[1], borderWidth: 2,
            data: [{ x: left, y: 1e-3 * memory * left }, { x: ridge, y: peak }, { x: right, y: peak }] },
        ],
      },
      options: {
        scales: { x: { type: "logarithmic", title: { display: true, text: "operations a byte" } }, y: { type: "logarithmic", title: { display: true, text: "TOP/s" } } },
        plugins: { tooltip: { callbacks: { label: (item) => `${item.raw.name ?? ""} ${item.parsed.x.toFixed(1)} op/byte, ${item.parsed.y.toFixed(3)} TOP/s` } } },
      },
    }));
    chart(place, "Intermediate tensors in the arena while a dispatch runs, MiB", () => ({
      type: "bar",
      data: { labels, datasets: [{ label: "live", data: rows.map((row) => row.live_bytes / 1048576), backgroundColor: colours[2], categoryPercentage: 1, barPercentage: 1 }] },
      options: { scales: { x: { ticks: { autoSkip: false, maxRotation: 90 } }, y: { beginAtZero: true } } },
      plugins: [marker("y", modelled.arena_bytes / 1048576, "arena")],
    }));
    (file.measured ?? []).forEach((bench) => show(place, bars(
      `Predicted and measured on ${bench.on}, inputs ${bench.inputs.map((shape) => shape.join("x")).join(", ")}, ms`,
      bench.dispatches.map((row) => row.name), [
        { label: "predicted", data: bench.dispatches.map((row) => row.predicted_ms), backgroundColor: colours[5] },
        { label: "measured", data: bench.dispatches.map((row) => row.time_ms), backgroundColor: colours[3] },
      ], "ms", false)));
    table([
      { title: "dispatch", at: "/name" }, { title: "operator", at: "/op" }, { title: "precision", at: "/precision" },
      { title: "MACs", at: "/macs", digits: 0 }, { title: "tile", unit: "rows", at: "/tile_height", digits: 0 },
      { title: "tile", unit: "columns", at: "/tile_width", digits: 0 }, { title: "halo", unit: "times", at: "/halo", digits: 3 },
      { title: "memory", unit: "MB", at: "/memory_bytes", digits: 2, scale: 1e-6 }, { title: "arithmetic", unit: "us", at: "/compute_us", digits: 1 },
      { title: "memory", unit: "us", at: "/memory_us", digits: 1 }, { title: "time", unit: "us", at: "/time_us", digits: 1 },
      { title: "bound by", at: "/bound" }, { title: "op/byte", at: "/ops_per_byte", digits: 1 },
      { title: "energy", unit: "uJ", at: "/energy_uj", digits: 1 },
    ], rows.map((_, i) => `${file.pointer}/modelled/dispatches/${i}`));
    (file.measured ?? []).forEach((bench, b) => {
      element("h3", `Measured on ${bench.on}, inputs ${bench.inputs.map((shape) => shape.join("x")).join(", ")}`);
      table([
        { title: "dispatch", at: "/name" }, { title: "kernel", at: "/kernel" }, { title: "measured", unit: "ms", at: "/time_ms", digits: 3 },
        { title: "predicted", unit: "ms", at: "/predicted_ms", digits: 3 }, { title: "rate", unit: "GOP/s", at: "/gop_per_s", digits: 1 },
        { title: "of the roof", unit: "%", at: "/share_of_roof", digits: 0, scale: 100 },
      ], bench.dispatches.map((_, i) => `${file.pointer}/measured/${b}/dispatches/${i}`).concat(`${file.pointer}/measured/${b}/total`));
    });
  }

  for (const file of files.filter((one) => one.kind === "package")) {
    element("h2", file.file);
    dim(`${file.model}, compiled for ${file.target}; arena ${(file.arena_bytes / 1048576).toFixed(2)} MiB`);
    const place = group();
    const rows = file.dispatches, labels = rows.map((row) => row.name);
    const series = [{ label: "predicted", data: rows.map((row) => row.time_us), backgroundColor: colours[5] }];
    if (rows.some((row) => row.measured_us !== undefined)) series.push({ label: "measured", data: rows.map((row) => row.measured_us ?? null), backgroundColor: colours[3] });
    show(place, bars("Time by dispatch, us", labels, series, "us", false));
    chart(place, "Intermediate tensors in the arena while a dispatch runs, MiB", () => ({
      type: "bar",
      data: { labels, datasets: [{ label: "live", data: rows.map((row) => row.live_bytes / 1048576), backgroundColor: colours[2], categoryPercentage: 1, barPercentage: 1 }] },
      options: { scales: { x: { ticks: { autoSkip: false, maxRotation: 90 } }, y: { beginAtZero: true } } },
      plugins: [marker("y", file.arena_bytes / 1048576, "arena")],
    }));
    table([
      { title: "dispatch", at: "/name" }, { title: "segment", at: "/segment" }, { title: "kernel", at: "/kernel" },
      { title: "MACs", at: "/macs", digits: 0 }, { title: "read", unit: "bytes", at: "/bytes_read", digits: 0 },
      { title: "written", unit: "bytes", at: "/bytes_written", digits: 0 }, { title: "predicted", unit: "us", at: "/time_us", digits: 1 },
      { title: "measured", unit: "us", at: "/measured_us", digits: 1 }, { title: "ratio", at: "/ratio", digits: 2 },
    ], rows.map((_, i) => `${file.pointer}/dispatches/${i}`));
  }
  start();
})();
