"use strict";
(() => {
  const report = JSON.parse(document.getElementById("report").textContent);
  const colours = ["#0072b2", "#d55e00", "#009e73", "#b35fa0", "#c98a00", "#3fa0d8", "#8264b5", "#7a7f85"];
  const dashes = [[], [6, 3], [2, 2]];

  // Plots over time. What is drawn is what the JSON says; an infinite PSNR, null there, is a gap.
  const kinds = [
    { title: "PSNR, dB (higher is better)", of: (f) => f.psnr_db },
    { title: "SSIM (higher is better)", of: (f) => f.ssim },
    { title: "FLIP (lower is better)", of: (f) => f.flip },
    { title: "Time, ms (lower is better)", of: (f) => f.time_ms, zero: true },
  ];
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const charts = [];
  const draw = () => {
    charts.splice(0).forEach((chart) => chart.destroy());
    Chart.defaults.color = style("--dim");
    Chart.defaults.borderColor = style("--line");
    Chart.defaults.font.family = getComputedStyle(document.body).fontFamily;
    report.scenes.forEach((scene, index) => {
      const place = document.getElementById("charts" + index);
      if (!place) return;
      place.replaceChildren();
      for (const kind of kinds) {
        const lines = scene.methods.map((method) => method.frames.map((f) => kind.of(f) ?? null));
        if (!lines.some((line) => line.some((value) => value !== null))) continue;
        const gaps = kind === kinds[0] && scene.methods.some((method) => method.frames.some((f) => f.psnr_infinite));
        const title = kind.title + (gaps ? "; a gap: equal to the reference" : "");
        const box = document.createElement("div");
        box.className = "chart";
        const canvas = document.createElement("canvas");
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", title + " over the frames of " + scene.name);
        box.append(canvas);
        place.append(box);
        charts.push(new Chart(canvas, {
          type: "line",
          data: {
            labels: Array.from({ length: scene.frames }, (_, i) => scene.first_frame + i),
            datasets: lines.map((line, m) => ({
              label: report.methods[m], data: line, borderWidth: 2, tension: 0,
              pointRadius: line.length > 40 ? 0 : 2, pointHitRadius: 8,
              borderColor: colours[m % colours.length], backgroundColor: colours[m % colours.length],
              borderDash: dashes[Math.floor(m / colours.length) % dashes.length],
            })),
          },
          options: {
            animation: false, maintainAspectRatio: false, interaction: { mode: "index", intersect: false },
            plugins: { title: { display: true, text: title }, legend: { position: "bottom", labels: { boxWidth: 18 } } },
            scales: { x: { title: { display: true, text: "frame" }, ticks: { maxTicksLimit: 12, maxRotation: 0 } }, y: { beginAtZero: !!kind.zero } },
          },
        }));
      }
    });
  };
  draw();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);

  // Two pictures with a divider between them.
  for (const compare of document.querySelectorAll(".compare")) {
    const stage = compare.querySelector(".stage");
    const images = [...stage.querySelectorAll("img")];
    const choices = document.getElementById(compare.dataset.choices);
    const [left, right] = choices.querySelectorAll("select");
    const show = () => {
      images.forEach((image, i) => {
        image.classList.toggle("left", i === left.selectedIndex);
        image.classList.toggle("right", i === right.selectedIndex);
      });
      stage.querySelector(".tag.from").textContent = left.options[left.selectedIndex].text;
      stage.querySelector(".tag.to").textContent = right.options[right.selectedIndex].text;
    };
    let split = 50;
    const move = (to) => {
      split = Math.min(100, Math.max(0, to));
      stage.style.setProperty("--split", split + "%");
      stage.setAttribute("aria-valuenow", Math.round(split));
    };
    const follow = (event) => {
      const box = stage.getBoundingClientRect();
      move((100 * (event.clientX - box.left)) / box.width);
    };
    stage.addEventListener("pointermove", follow);
    stage.addEventListener("pointerdown", follow);
    stage.addEventListener("keydown", (event) => {
      const step = event.shiftKey ? 10 : 2;
      const to = { ArrowLeft: split - step, ArrowRight: split + step, Home: 0, End: 100 }[event.key];
      if (to === undefined) return;
      move(to);
      event.preventDefault();
    });
    left.addEventListener("change", show);
    right.addEventListener("change", show);
    choices.querySelector("input").addEventListener("change", (event) =>
      compare.classList.toggle("actual", event.target.checked));
    show();
    move(50);
  }
})();
