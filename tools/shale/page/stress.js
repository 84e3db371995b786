"use strict";
(() => {
  const { data, colours, element, table, chart, group, dim, start } = page;
  const limits = data.limits;
  dim(`${data.model}, ${data.render.join("x")} to ${data.output.join("x")}, on ${data.device}${data.generates ? ", with a generated picture for each frame" : ""}. ${data.hold} of ${data.verdicts} verdicts hold. Limits: all values finite; the output between 0 and the brightest colour that went in, to ${limits.overshoot} of x / (1 + x);${limits.codes === undefined ? "" : ` after ${limits.after_frames} frames at most ${limits.codes.toFixed(0)} display codes of a fault are left, two more than of a cut;`} over time at most ${limits.drift_codes} codes of drift in the mean; the network as the interpreter has it; at most ${limits.reference_codes} codes in the mean from the model. ${data.reference}.`);
  const lines = (place, title, rows, name, unit) => chart(place, title, () => ({
    type: "line",
    data: {
      labels: rows[0].codes.map((_, i) => i),
      datasets: rows.map((row, i) => ({ label: row[name], data: row.codes, borderColor: colours[i % colours.length], borderDash: i < colours.length ? [] : [4, 3], borderWidth: 1.5, pointRadius: 0 })),
    },
    options: { scales: { x: { title: { display: true, text: unit } }, y: { beginAtZero: true, title: { display: true, text: "display codes" } } } },
  }));
  if (data.faults.length) {
    element("h2", "Faults");
    dim("A fault in four frames between clean ones, against the same frames without it.");
    table([
      { title: "group", at: "/group" }, { title: "fault", at: "/fault" }, { title: "low", unit: "output", at: "/low", digits: 3 },
      { title: "high", unit: "output", at: "/high", digits: 3 }, { title: "struck", unit: "codes, largest", at: "/struck_codes", digits: 0 },
      { title: "area", unit: "% of pixels", at: "/struck_share", scale: 100, digits: 1 }, { title: "reach", unit: "pixels", at: "/reach", digits: 1 },
      { title: "lasts", unit: "frames after", at: "/lasts_frames", digits: 0 }, { title: "left", unit: "codes", at: "/left_codes", digits: 0 },
      { title: "of model, largest", unit: "codes", at: "/reference_largest_codes", digits: 0 }, { title: "of model, mean", unit: "codes", at: "/reference_mean_codes", digits: 4 },
      { title: "verdict", at: "/verdict" },
    ], data.faults.map((_, i) => `/faults/${i}`));
    const place = group();
    for (const name of [...new Set(data.faults.map((row) => row.group))])
      lines(place, name, data.faults.filter((row) => row.group === name), "fault", "frame");
    const tensors = [...new Set(data.faults.flatMap((row) => Object.keys(row.saturated)))];
    if (tensors.length) {
      element("h2", "Codes at the ends of int8, % of a tensor, in the last frame of the fault");
      table([{ title: "group", at: "/group" }, { title: "fault", at: "/fault" }].concat(tensors.map((name) =>
        ({ title: name, at: "/saturated/" + name.replaceAll("~", "~0").replaceAll("/", "~1"), scale: 100, digits: 1 }))), data.faults.map((_, i) => `/faults/${i}`));
    }
  }
  if (data.courses.length) {
    element("h2", "Over time");
    dim("The same cycle of frames, over and over: each against the second one.");
    table([
      { title: "course", at: "/course" }, { title: "frames", at: "/frames", digits: 0 }, { title: "drift", unit: "codes, mean", at: "/drift_mean_codes", digits: 3 },
      { title: "largest", unit: "codes", at: "/drift_largest_codes", digits: 0 }, { title: "rate", unit: "codes in 1000 frames", at: "/drift_codes_per_1000_frames", digits: 4 },
      { title: "of model, largest", unit: "codes", at: "/reference_largest_codes", digits: 0 }, { title: "of model, mean", unit: "codes", at: "/reference_mean_codes", digits: 4 },
      { title: "of model", unit: "codes in 1000 frames", at: "/reference_codes_per_1000_frames", digits: 5 },
      { title: "swing at rest", unit: "codes, mean", at: "/swing_codes", digits: 2 }, { title: "memory", unit: "MB more", at: "/memory_growth_mb", digits: 1 },
      { title: "verdict", at: "/verdict" },
    ], data.courses.map((_, i) => `/courses/${i}`));
    lines(group(), "difference from the second cycle, mean", data.courses, "course", "cycle");
  }
  if (data.bounds.length) {
    element("h2", "Bounds");
    dim("What the contracts of the passes and the weights prove for every input, and what all frames above showed: the ends over the channels, and how much of the proven range was found, in the channel where that is least and where it is most.");
    table([
      { title: "of", at: "/of" }, { title: "proven", unit: "least", at: "/proven_least", digits: 3 }, { title: "proven", unit: "most", at: "/proven_most", digits: 3 },
      { title: "found", unit: "least", at: "/least_found", digits: 3 }, { title: "found", unit: "most", at: "/most_found", digits: 3 },
      { title: "of the proven range", unit: "%, least", at: "/share_least", scale: 100, digits: 1 }, { title: "of the proven range", unit: "%, most", at: "/share_most", scale: 100, digits: 1 },
      { title: "verdict", at: "/verdict" },
    ], data.bounds.map((_, i) => `/bounds/${i}`));
  }
  const precision = [{ title: "precision", at: "/precision" }, { title: "against fp32", unit: "dB", at: "/psnr_db", digits: 2 }, { title: "largest", unit: "codes", at: "/largest_codes", digits: 0 },
    { title: "frame", at: "/frame", digits: 0 }, { title: "x", at: "/x", digits: 0 }, { title: "y", at: "/y", digits: 0 }];
  if (data.precisions.length) {
    element("h2", "Precisions");
    table(precision, data.precisions.map((_, i) => `/precisions/${i}`));
  }
  if (data.search) {
    element("h2", "The inputs that part int8 from fp32 most");
    table(precision.concat([{ title: "steps", at: "/steps", digits: 0 }, { title: "kept", at: "/kept", digits: 0 }, { title: "at the start", unit: "dB", at: "/start_psnr_db", digits: 2 }, { title: "seed", at: "/seed", digits: 0 }]), ["/search"]);
  }
  start();
})();
