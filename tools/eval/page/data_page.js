"use strict";
// What pages made of data share. Every number in a table is looked up by its JSON pointer, which
// stands in the cell as data-at.
const page = (() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const main = document.getElementById("main");
  const colours = ["#0072b2", "#d55e00", "#009e73", "#b35fa0", "#c98a00", "#3fa0d8", "#8264b5", "#7a7f85"];
  const at = (pointer) => pointer.split("/").slice(1).reduce((value, key) => value?.[key.replaceAll("~1", "/").replaceAll("~0", "~")], data);
  const element = (tag, text, parent = main) => {
    const node = document.createElement(tag);
    if (text !== undefined) node.textContent = text;
    parent.append(node);
    return node;
  };
  const shown = (value, digits) =>
    value === null || value === undefined ? "\u2013"
      : typeof value === "number" ? value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits })
      : String(value);
  // columns: { title, unit, at (below the row's pointer), digits, scale, better: 1 or -1 }; rows: pointers.
  const table = (columns, rows, parent = main) => {
    const scroll = element("div", undefined, parent);
    scroll.className = "scroll";
    const body = element("table", undefined, scroll);
    const head = element("tr", undefined, element("thead", undefined, body));
    const present = columns.filter((column) => rows.some((row) => at(row + column.at) !== undefined && at(row + column.at) !== null));
    for (const column of present) {
      const th = element("th", column.title, head);
      th.scope = "col";
      if (column.unit) element("small", column.unit, th);
    }
    const lines = element("tbody", undefined, body);
    const best = present.map((column) => {
      if (!column.better || rows.length < 2) return undefined;
      const values = rows.map((row) => at(row + column.at)).filter((value) => typeof value === "number");
      return values.length > 1 ? shown((column.scale ?? 1) * Math[column.better > 0 ? "max" : "min"](...values), column.digits) : undefined;
    });
    for (const row of rows) {
      const tr = element("tr", undefined, lines);
      present.forEach((column, i) => {
        const value = at(row + column.at);
        const td = element("td", shown(typeof value === "number" ? value * (column.scale ?? 1) : value, column.digits), tr);
        td.dataset.at = row + column.at;
        if (column.scale) td.dataset.scale = column.scale;
        if (typeof value === "number" && td.textContent === best[i]) td.classList.add("best");
      });
    }
  };
  // Charts are made again when the colour scheme changes.
  const makers = [];
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const chart = (parent, title, make) => {
    const box = element("div", undefined, parent);
    box.className = "chart";
    const canvas = element("canvas", undefined, box);
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", title);
    makers.push(() => {
      const config = make();
      config.options = { animation: false, maintainAspectRatio: false, ...config.options };
      config.options.plugins = {
        ...config.options.plugins, title: { display: true, text: title },
        legend: { position: "bottom", labels: { boxWidth: 18 }, ...config.options.plugins?.legend },
      };
      return new Chart(canvas, config);
    });
    return box;
  };
  const charts = [];
  const draw = () => {
    charts.splice(0).forEach((made) => made.destroy());
    Chart.defaults.color = style("--dim");
    Chart.defaults.borderColor = style("--line");
    Chart.defaults.font.family = getComputedStyle(document.body).fontFamily;
    makers.forEach((make) => charts.push(make()));
  };
  const group = () => {
    const box = element("div");
    box.className = "charts";
    return box;
  };
  const dim = (text, parent = main) => {
    const p = element("p", text, parent);
    p.className = "dim";
    return p;
  };
  // A line across a chart at a value of one axis.
  const marker = (axis, value, text) => ({
    id: "marker" + axis + value,
    afterDatasetsDraw(made) {
      const scale = made.scales[axis], area = made.chartArea, context = made.ctx;
      const place = scale.getPixelForValue(value);
      context.save();
      context.strokeStyle = context.fillStyle = colours[1];
      context.setLineDash([5, 4]);
      context.beginPath();
      if (axis === "x") context.moveTo(place, area.top), context.lineTo(place, area.bottom);
      else context.moveTo(area.left, place), context.lineTo(area.right, place);
      context.stroke();
      context.fillText(text, axis === "x" ? place + 4 : area.left + 4, axis === "x" ? area.top + 10 : place - 4);
      context.restore();
    },
  });
  const start = () => {
    draw();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  };
  return { data, main, colours, at, element, table, chart, group, dim, marker, start };
})();
