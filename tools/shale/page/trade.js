"use strict";
(() => {
  const { data, colours, element, table, chart, group, dim, marker, start } = page;
  dim(`Quality measured on ${data.device} at ${data.output.join("x")}; time modelled on ${data.modelled_device} for results of ${data.modelled_output.join("x")}, passes by their memory traffic. Budget: ${data.frame_ms} ms a frame.`);
  for (const row of data.left_out ?? []) element("p", `Left out: ${row.name} at x${row.scale}: ${row.why}`);
  const kinds = ["int8", "int16", "fp16", "fp32", ""];
  const label = (row) => `${row.name}, x${row.scale}`;
  const plot = (place, scene, title, quality, cost, costTitle, mark, budget) => {
    const rows = scene.methods.filter((row) => typeof row[quality] === "number");
    if (!rows.length) return;
    const point = (row) => ({ x: cost(row), y: row[quality], name: label(row) });
    const front = rows.filter((row) => row.fronts.includes(mark)).map(point).sort((a, b) => a.x - b.x);
    chart(place, title, () => ({
      type: "scatter",
      data: {
        datasets: kinds.map((kind, i) => ({
          label: kind || "no network", data: rows.filter((row) => row.precision === kind).map(point),
          backgroundColor: colours[i], pointRadius: 5, pointStyle: kind ? "circle" : "triangle",
        })).filter((set) => set.data.length).concat({
          label: "Pareto front", type: "line", data: front, showLine: true, borderColor: colours[7], borderWidth: 1.5, pointRadius: 0, borderDash: [4, 3],
        }),
      },
      options: {
        scales: { x: { beginAtZero: true, title: { display: true, text: costTitle } }, y: {} },
        plugins: { tooltip: { callbacks: { label: (item) => `${item.raw.name}: ${item.parsed.x.toFixed(2)}, ${item.parsed.y.toFixed(4)}` } } },
      },
      plugins: budget ? [marker("x", data.frame_ms, "budget")] : [],
    }));
  };
  const show = (scene, pointer) => {
    element("h2", scene.name);
    const choice = scene.choice;
    if (choice) {
      const gain = choice.gain_db === undefined ? "" : `, ${choice.gain_db.toFixed(2)} dB above the best baseline that fits, ${choice.best_baseline}`;
      element("p", `Best under the budget: ${choice.best} at x${choice.best_scale}, ${choice.best_psnr_db.toFixed(2)} dB, ${choice.best_ms.toFixed(2)} ms${gain}.`);
      for (const within of choice.within) {
        const why = within.why.length ? `: ${within.why.join(", ")}` : "";
        element("p", `Enough within ${within.slack_db} dB: ${within.name} at x${within.scale}, ${within.psnr_db.toFixed(2)} dB, ${within.ms.toFixed(2)} ms. `
          + (within.needs_network ? `The scene asks for a network${why}.` : `The scene needs no network${why}.`));
      }
    } else element("p", "Nothing fits the budget.");
    const place = group();
    const time = (row) => row.modelled.total_ms;
    plot(place, scene, "PSNR, dB, over modelled ms", "psnr_db", time, "ms", "psnr_db over ms", true);
    plot(place, scene, "FLIP (lower is better) over modelled ms", "flip", time, "ms", "flip over ms", true);
    plot(place, scene, "IF-SSIM over modelled ms", "if_ssim", time, "ms", "if_ssim over ms", true);
    plot(place, scene, "PSNR, dB, over GOP", "psnr_db", (row) => row.modelled.gop, "GOP", "psnr_db over GOP", false);
    table([
      { title: "method", at: "/name" }, { title: "scale", at: "/scale", digits: 2 }, { title: "PSNR", unit: "dB, higher", at: "/psnr_db", digits: 2, better: 1 },
      { title: "SSIM", unit: "higher", at: "/ssim", digits: 4, better: 1 }, { title: "FLIP", unit: "lower", at: "/flip", digits: 4, better: -1 },
      { title: "IF-SSIM", unit: "higher", at: "/if_ssim", digits: 4, better: 1 }, { title: "work", unit: "GOP", at: "/modelled/gop", digits: 2 },
      { title: "passes", unit: "ms, modelled", at: "/modelled/passes_ms", digits: 2 }, { title: "network", unit: "ms, modelled", at: "/modelled/network_ms", digits: 2 },
      { title: "frame", unit: "ms, modelled", at: "/modelled/total_ms", digits: 2 }, { title: "energy", unit: "mJ, estimate", at: "/modelled/energy_mj", digits: 1 },
      { title: "frame", unit: "ms, measured", at: "/measured_ms", digits: 1 }, { title: "run", unit: "share, by tiles", at: "/share_run", digits: 2 },
    ], scene.methods.map((_, i) => `${pointer}/methods/${i}`));
  };
  show(data.overall, "/overall");
  data.scenes.forEach((scene, i) => show(scene, "/scenes/" + i));
  start();
})();
