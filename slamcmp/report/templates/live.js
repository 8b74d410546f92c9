const escaped = text => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
const dark = matchMedia("(prefers-color-scheme: dark)");
const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const WIDTHS = [4.5, 3.2, 2.2, 1.4];
const DASHES = ["solid", "dash", "dot", "dashdot"];
const MARKS = ["circle", "square", "triangle-up", "diamond", "triangle-down", "cross", "x"];
const small = () => innerWidth < 640;
function colour(index) {
  const known = dark.matches ? live.dark : live.light;
  return index === undefined ? css("--text") : known[index % known.length];
}
function axis(title, more) {
  return {title: {text: title, font: {size: 12}}, gridcolor: css("--line"), zerolinecolor: css("--line"),
    linecolor: css("--line"), automargin: true, ...more};
}
function layout(rows, height) {
  return {height: height * rows + 90, margin: {l: 10, r: 10, t: 24, b: 10}, paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)", font: {color: css("--text"), size: 12}, hovermode: "closest",
    legend: {orientation: "h", y: -58 / (height * rows), yanchor: "top"}, dragmode: small() ? false : "zoom", shapes: []};
}
const span = (index, count, gap) => {
  const size = (1 - gap * (count - 1)) / count, top = 1 - index * (size + gap);
  return [Math.max(0, top - size), top];
};
function stack(figure) {
  const shown = [], page = layout(figure.panels.length, 210), seen = new Set();
  page.grid = {rows: figure.panels.length, columns: 1, pattern: "coupled"};
  page.xaxis = axis(figure.x, figure.logx ? {type: "log"} : {});
  page.xaxis.anchor = "y" + (figure.panels.length > 1 ? figure.panels.length : "");
  figure.panels.forEach((panel, index) => {
    const n = index ? index + 1 : "";
    page["yaxis" + n] = axis(panel.y, {domain: span(index, figure.panels.length, 0.05),
      ...(panel.log ? {type: "log"} : {})});
    if (panel.band) page.shapes.push({type: "rect", layer: "below", xref: "paper", x0: 0, x1: 1, yref: "y" + n,
      y0: panel.band[0], y1: panel.band[1], fillcolor: css("--faint"), opacity: 0.2, line: {width: 0}});
    for (const each of panel.traces) {
      const group = escaped(each.name), c = colour(each.colour), place = each.colour || 0;
      shown.push({x: each.x, y: each.y, yaxis: "y" + n, name: group, legendgroup: group,
        showlegend: !seen.has(group), mode: each.marks ? "markers" : "lines",
        marker: {color: c, size: each.marks, symbol: MARKS[place % MARKS.length], opacity: each.marks < 10 ? 0.5 : 1},
        line: {color: c, width: each.thin ? 1 : WIDTHS[Math.min(place, 3)],
          dash: each.dash || DASHES[place % DASHES.length]}});
      seen.add(group);
    }
  });
  return [shown, page];
}
function seeds(figure) {
  const shown = [], page = layout(figure.panels.length, 260);
  page.showlegend = false;
  figure.panels.forEach((panel, index) => {
    const n = index ? index + 1 : "", names = panel.labels.map(escaped);
    page["yaxis" + n] = axis(panel.y, {domain: span(index, figure.panels.length, 0.16), anchor: "x" + n});
    page["xaxis" + n] = axis("", {type: "category", anchor: "y" + n});
    const at = {xaxis: "x" + n, yaxis: "y" + n};
    names.forEach((name, place) => shown.push({...at, type: "box", name, y: panel.rows.map(row => row[place]),
      x: panel.rows.map(() => name), boxpoints: false, line: {color: colour(panel.colours[place])}}));
    for (const row of panel.rows) shown.push({...at, x: names, y: row, mode: "lines+markers", hoverinfo: "y",
      line: {color: css("--faint"), width: 0.7}, marker: {size: 6, color: panel.colours.map(colour)}});
  });
  return [shown, page];
}
function ellipse(x, y, P) {
  const [xx, xy, yy] = P, r = Math.sqrt(5.991), mean = (xx + yy) / 2, turn = Math.atan2(2 * xy, xx - yy) / 2;
  const away = Math.hypot((xx - yy) / 2, xy), a = r * Math.sqrt(Math.max(0, mean + away)),
    b = r * Math.sqrt(Math.max(0, mean - away)), xs = [], ys = [];
  for (let i = 0; i <= 40; i++) {
    const u = a * Math.cos(i * Math.PI / 20), v = b * Math.sin(i * Math.PI / 20);
    xs.push(x + u * Math.cos(turn) - v * Math.sin(turn));
    ys.push(y + u * Math.sin(turn) + v * Math.cos(turn));
  }
  return [xs, ys];
}
function rays(x, y, heading, [ahead, left]) {
  const xs = [], ys = [], c = Math.cos(heading), s = Math.sin(heading);
  ahead.forEach((a, j) => {
    xs.push(x, x + c * a - s * left[j], null);
    ys.push(y, y + s * a + c * left[j], null);
  });
  return [xs, ys];
}
function map(figure, box) {
  const runs = figure.runs, columns = small() ? 1 : Math.min(3, runs.length), rows = Math.ceil(runs.length / columns);
  const shown = [], page = layout(rows, small() ? 320 : 420), moving = [], seen = new Set();
  page.annotations = [];
  const add = (name, trace, n) => {
    shown.push({mode: "lines", name, legendgroup: name, showlegend: !seen.has(name), xaxis: "x" + n, yaxis: "y" + n,
      ...trace});
    seen.add(name);
    return shown.length - 1;
  };
  runs.forEach((run, index) => {
    const n = index ? index + 1 : "", c = colour(run.colour), column = index % columns;
    const domain = [column / columns + (column ? 0.03 : 0), (column + 1) / columns - 0.01];
    page["xaxis" + n] = axis("x [m]", {domain, anchor: "y" + n, ...(index ? {matches: "x"} : {})});
    page["yaxis" + n] = axis(column ? "" : "y [m]", {domain: span(Math.floor(index / columns), rows, 0.14), anchor: "x" + n,
      ...(index ? {matches: "y"} : {scaleanchor: "x"})});
    page.annotations.push({text: escaped(run.label), showarrow: false, xref: "x" + n + " domain", yref: "y" + n + " domain",
      x: 0, y: 1, yanchor: "bottom", font: {color: c, size: 13}});
    const line = {color: c};
    if (run.landmarks) add("landmarks", {x: run.landmarks[0], y: run.landmarks[1], mode: "markers",
      marker: {color: css("--faint"), size: 5}}, n);
    if (run.true) add(escaped(figure.reference), {x: run.true[0], y: run.true[1], line: {color: css("--text"), width: 1}}, n);
    if (run.online) add("online", {x: run.online[0], y: run.online[1], line: {...line, dash: "dash", width: 1.6}}, n);
    if (run.final) add("final", {x: run.final[0], y: run.final[1], line: {...line, width: 2}}, n);
    const steps = run.steps;
    if (steps.P) moving.push([add("95 % ellipse", {x: [], y: [], fill: "toself", line: {...line, width: 1.5}}, n),
      i => ellipse(steps.x[i], steps.y[i], steps.P.map(each => each[i])), steps]);
    if (steps.sights) moving.push([add("measured now", {x: [], y: [], mode: "lines+markers", line: {...line, width: 1},
      opacity: 0.7, marker: {color: c, size: 6, symbol: "x-thin", line: {color: c, width: 1.5}}}, n),
      i => rays(steps.x[i], steps.y[i], steps.heading[i], steps.sights[i]), steps]);
    moving.push([add("now", {x: [], y: [], mode: "markers", marker: {color: c, size: 11,
      line: {color: css("--text"), width: 1.5}}}, n), i => [[steps.x[i]], [steps.y[i]]], steps]);
  });
  const most = Math.max(...runs.map(run => run.steps.t.length)) - 1;
  const bar = document.createElement("p"), play = document.createElement("button");
  const slider = document.createElement("input"), time = document.createElement("output");
  bar.className = "player";
  play.type = "button";
  play.textContent = "play";
  Object.assign(slider, {type: "range", min: 0, max: most, step: 1, value: most});
  slider.setAttribute("aria-label", "time");
  const show = () => {
    const i = Number(slider.value), xs = [], ys = [];
    for (const [, place, steps] of moving) {
      const [x, y] = place(Math.min(i, steps.t.length - 1));
      xs.push(x);
      ys.push(y);
    }
    time.textContent = Number(runs[0].steps.t[Math.min(i, runs[0].steps.t.length - 1)]).toFixed(1) + " s";
    return Plotly.restyle(box, {x: xs, y: ys}, moving.map(each => each[0]));
  };
  slider.addEventListener("input", show);
  let timer = 0;
  play.addEventListener("click", () => {
    if (timer) { clearInterval(timer); timer = 0; play.textContent = "play"; return; }
    if (Number(slider.value) >= most) slider.value = 0;
    play.textContent = "stop";
    timer = setInterval(() => {
      slider.value = Number(slider.value) + 1;
      show();
      if (Number(slider.value) >= most) { clearInterval(timer); timer = 0; play.textContent = "play"; }
    }, 60);
  });
  box.parentElement.querySelectorAll(".player").forEach(old => old.remove());
  bar.append(play, slider, time);
  box.before(bar);
  return [shown, page, show];
}
async function draw() {
  for (const box of document.querySelectorAll(".live")) {
    const figure = live.figures[box.dataset.figure];
    box.hidden = false;
    const [traces, page, after] = {map, stack, seeds}[figure.kind](figure, box);
    await Plotly.react(box, traces, page, {responsive: true, displaylogo: false, scrollZoom: false});
    if (after) await after();
    box.closest("figure").classList.add("alive");
  }
}
async function start() {
  const content = atob(packed.slice(packed.indexOf(",") + 1));
  const stream = new Blob([Uint8Array.from(content, each => each.charCodeAt(0))]).stream();
  const script = document.createElement("script");
  script.textContent = await new Response(stream.pipeThrough(new DecompressionStream("gzip"))).text();
  document.head.append(script);
  await draw();
  dark.addEventListener("change", draw);
  document.documentElement.dataset.live = "ready";
}
if (Object.keys(live.figures).length && "DecompressionStream" in window) start();
