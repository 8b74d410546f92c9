const escaped = text => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
const dark = matchMedia("(prefers-color-scheme: dark)");
const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const WIDTHS = [5, 3.4, 2.1, 1.1];
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
  return {height: height * rows + 90, margin: {l: 10, r: 10, t: 34, b: 10}, paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)", font: {color: css("--text"), size: 12}, hovermode: "closest",
    legend: {orientation: "h", y: -58 / (height * rows), yanchor: "top"},
    modebar: {bgcolor: "rgba(0,0,0,0)", color: css("--faint"), activecolor: css("--text")}, dragmode: small() ? false : "zoom", shapes: []};
}
const round = value => Number(value.toPrecision(3));
function logTicks(values) {
  const known = values.filter(each => each > 0), least = Math.min(...known), most = Math.max(...known);
  const wide = Math.log10(most / least);
  const steps = wide < 0.5 ? [1, 1.5, 2, 3, 4, 5, 6, 8] : wide < 1.2 ? [1, 2, 3, 5, 7] : wide < 2.5 ? [1, 2, 5] : [1];
  const ticks = [];
  for (let power = Math.floor(Math.log10(least)) - 1; power <= Math.log10(most) + 1; power++)
    for (const step of steps) ticks.push(round(step * 10 ** power));
  return known.length ? {type: "log", tickvals: ticks, ticktext: ticks.map(String)} : {type: "log"};
}
const bars = ([plus, minus]) => ({type: "data", array: plus, arrayminus: minus, width: 0, thickness: 1});
const span = (index, count, gap) => {
  const size = (1 - gap * (count - 1)) / count, top = 1 - index * (size + gap);
  return [Math.max(0, top - size), top];
};
function stack(figure) {
  const shown = [], page = layout(figure.panels.length, 210), seen = new Set();
  page.grid = {rows: figure.panels.length, columns: 1, pattern: "coupled"};
  const all = which => figure.panels.flatMap(panel => panel.traces.flatMap(each => each[which]));
  page.xaxis = axis(figure.x, figure.logx ? logTicks(all("x")) : {});
  page.xaxis.anchor = "y" + (figure.panels.length > 1 ? figure.panels.length : "");
  figure.panels.forEach((panel, index) => {
    const n = index ? index + 1 : "";
    page["yaxis" + n] = axis(panel.y, {domain: span(index, figure.panels.length, 0.05),
      ...(panel.log ? logTicks(panel.traces.flatMap(each => each.y)) : {})});
    if (panel.band) page.shapes.push({type: "rect", layer: "below", xref: "paper", x0: 0, x1: 1, yref: "y" + n,
      y0: panel.band[0], y1: panel.band[1], fillcolor: css("--faint"), opacity: 0.2, line: {width: 0}});
    for (const each of panel.traces) {
      const group = escaped(each.name), c = colour(each.colour), place = each.colour || 0;
      // Of a back end's marks the large one is the key.
      const named = !seen.has(group) && !(each.marks && !each.bars);
      shown.push({x: each.x, y: each.y, yaxis: "y" + n, name: group, legendgroup: group,
        showlegend: named, mode: each.bars ? "lines+markers" : each.marks ? "markers" : "lines",
        ...(each.bars ? {error_x: bars(each.bars[0]), error_y: bars(each.bars[1])} : {}),
        marker: {color: c, size: each.marks, symbol: MARKS[place % MARKS.length], opacity: each.marks < 10 ? 0.5 : 1},
        line: {color: c, width: each.thin || each.bars ? 1 : WIDTHS[Math.min(place, 3)],
          dash: each.dash || (each.marks ? "solid" : DASHES[place % DASHES.length])}});
      if (named) seen.add(group);
    }
  });
  return [shown, page];
}
function seeds(figure) {
  const shown = [], page = layout(figure.panels.length, 260), order = figure.order.map(escaped);
  page.showlegend = false;
  figure.panels.forEach((panel, index) => {
    const n = index ? index + 1 : "", names = panel.labels.map(escaped);
    page["yaxis" + n] = axis(panel.y, {domain: span(index, figure.panels.length, 60 / (260 * figure.panels.length)), anchor: "x" + n});
    page["xaxis" + n] = axis("", {type: "category", anchor: "y" + n, categoryorder: "array", categoryarray: order,
      range: [-0.5, order.length - 0.5]});
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
  const height = small() ? 320 : 420, shown = [], page = layout(rows, height), moving = [], keys = [], seen = new Set();
  page.annotations = [];
  page.margin = {l: 52, r: 10, t: 34, b: 46};
  const plain = {color: css("--text")};
  const add = (name, trace, n) => {
    // The legend names a kind of line, which each panel draws in its own colour.
    if (!seen.has(name)) keys.push({mode: "lines", name, legendgroup: name, ...trace, x: [null], y: [null],
      line: {...trace.line, ...plain}, marker: {...trace.marker, ...plain, line: {...trace.marker?.line, ...plain}},
      ...(trace.fill ? {fillcolor: css("--line")} : {})});
    seen.add(name);
    shown.push({mode: "lines", name, legendgroup: name, showlegend: false, xaxis: "x" + n, yaxis: "y" + n, ...trace});
    return shown.length - 1;
  };
  runs.forEach((run, index) => {
    const n = index ? index + 1 : "", c = colour(run.colour), column = index % columns;
    const domain = [column / columns + (column ? 0.03 : 0), (column + 1) / columns - 0.01];
    page["xaxis" + n] = axis("x [m]", {domain, anchor: "y" + n, automargin: false, ...(index ? {matches: "x"} : {})});
    page["yaxis" + n] = axis(column ? "" : "y [m]", {domain: span(Math.floor(index / columns), rows, 76 / (height * rows)),
      anchor: "x" + n, automargin: false,
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
  const bar = player(box, "time", most, i => {
    const xs = [], ys = [];
    for (const [, place, steps] of moving) {
      const [x, y] = place(Math.min(i, steps.t.length - 1));
      xs.push(x);
      ys.push(y);
    }
    bar.say(Number(runs[0].steps.t[Math.min(i, runs[0].steps.t.length - 1)]).toFixed(1) + " s");
    return Plotly.restyle(box, {x: xs, y: ys}, moving.map(each => each[0]));
  });
  return [[...shown, ...keys], page, bar.show];
}
function player(box, name, most, move) {
  const bar = document.createElement("p"), play = document.createElement("button");
  const slider = document.createElement("input"), said = document.createElement("output");
  bar.className = "player";
  play.type = "button";
  play.textContent = "play";
  Object.assign(slider, {type: "range", min: 0, max: most, step: 1, value: most});
  slider.setAttribute("aria-label", name);
  const show = () => move(Number(slider.value));
  slider.addEventListener("input", show);
  let timer = 0;
  const stop = () => { clearInterval(timer); timer = 0; play.textContent = "play"; };
  play.addEventListener("click", () => {
    if (timer) { stop(); return; }
    if (Number(slider.value) >= Number(slider.max)) slider.value = 0;
    play.textContent = "stop";
    timer = setInterval(() => {
      slider.value = Number(slider.value) + 1;
      show();
      if (Number(slider.value) >= Number(slider.max)) stop();
    }, Math.max(60, Math.min(400, 6000 / slider.max)));
  });
  box.parentElement.querySelectorAll(".player").forEach(old => old.ariaLabel === name && old.remove());
  bar.ariaLabel = name;
  bar.append(play, slider, said);
  box.before(bar);
  return {show, slider, say: text => { said.textContent = text; }};
}
function sparsity(figure, box) {
  const columns = small() ? 1 : 3, page = layout(3 / columns, small() ? 340 : 400), shown = [];
  const scale = [[0, "rgba(0,0,0,0)"], [0.34, "rgba(0,0,0,0)"], [0.34, colour(0)], [0.67, colour(0)],
    [0.67, colour(1)], [1, colour(1)]];
  const height = small() ? 340 : 400, rows = 3 / columns;
  page.annotations = [];
  page.margin = {l: 10, r: 10, t: 34, b: 10};
  for (let panel = 0; panel < 3; panel++) {
    const n = panel ? panel + 1 : "", column = panel % columns;
    const blank = {showgrid: false, zeroline: false, showticklabels: false, constrain: "domain", automargin: false, ticks: "",
      showline: true, mirror: true, linecolor: css("--line")};
    page["xaxis" + n] = {...blank, domain: [column / columns + 0.01, (column + 1) / columns - 0.01], anchor: "y" + n};
    page["yaxis" + n] = {...blank, domain: span(Math.floor(panel / columns), rows, 50 / (height * rows)),
      anchor: "x" + n, scaleanchor: "x" + n, autorange: "reversed"};
    page.annotations.push({text: "", showarrow: false, xref: "x" + n + " domain", yref: "y" + n + " domain", x: 0, y: 1,
      yanchor: "bottom", align: "left", font: {size: 12}});
    shown.push({type: "heatmap", z: [[0]], text: [[""]], hovertemplate: "%{text}<extra></extra>", colorscale: scale,
      zmin: 0, zmax: 2, showscale: false, xaxis: "x" + n, yaxis: "y" + n, xgap: 0.4, ygap: 0.4});
  }
  for (const [name, index] of [["shares a measurement", 0], ["fill-in", 1]]) shown.push({name, x: [null], y: [null],
    mode: "markers", marker: {symbol: "square", size: 10, color: colour(index)}, xaxis: "x", yaxis: "y"});
  page.legend.y = -20 / (height * rows);
  const matrix = (nodes, pairs, full) => {
    const place = new Map(nodes.map((node, i) => [node, i])), z = nodes.map(() => nodes.map(() => 0));
    nodes.forEach((_, i) => { z[i][i] = 1; });
    for (const [list, mark] of pairs) for (const [one, other] of list) {
      if (!place.has(one) || !place.has(other)) continue;
      const [i, j] = [place.get(one), place.get(other)].sort((a, b) => b - a);
      z[i][j] = mark;
      if (full) z[j][i] = mark;
    }
    return z;
  };
  const count = z => {
    const all = z.flat(), filled = all.filter(each => each === 2).length;
    return `${all.filter(Boolean).length} blocks of ${all.length}${filled ? `, ${filled} filled` : ""}`;
  };
  const moments = figure.moments;
  let ended = true;
  const show = () => {
    const now = moments[Number(time.slider.value)], size = now.order.length, steps = done.slider;
    steps.max = size;
    if (ended) steps.value = size;
    const gone = Number(steps.value), nodes = now.names.map((_, i) => i);
    const fill = now.fill.filter(each => each[2] <= gone);
    const parts = [[nodes, matrix(nodes, [[now.edges, 1]], true), "information"],
      [now.order, matrix(now.order, [[now.edges, 1], [fill, 2]], false), "its factor"],
      [now.kept, matrix(now.kept, [[now.edges, 1], [now.left, 2]], true), "what a filter keeps"]];
    time.say(now.t + " s");
    done.say(`${gone} of ${size} eliminated`);
    const text = parts.map(([order, z]) => z.map((row, i) => row.map((mark, j) =>
      escaped(`${now.names[order[i]]}, ${now.names[order[j]]}${["", ": share a measurement", ": filled"][mark]}`))));
    const titles = Object.fromEntries(parts.map(([, z, what], i) => [`annotations[${i}].text`, `${what}: ${count(z)}`]));
    const frame = gone < size ? [{type: "rect", xref: "x2", yref: "y2", x0: gone - 0.5, x1: size - 0.5, y0: gone - 0.5,
      y1: size - 0.5, line: {color: css("--text"), width: 1, dash: "dot"}}] : [];
    return Plotly.update(box, {z: parts.map(part => part[1]), text}, {...titles, shapes: frame}, [0, 1, 2]);
  };
  const time = player(box, "time", moments.length - 1, show);
  const done = player(box, "eliminations", moments[moments.length - 1].order.length, () => {
    ended = Number(done.slider.value) >= Number(done.slider.max);
    return show();
  });
  return [shown, page, show];
}
async function draw() {
  for (const box of document.querySelectorAll(".live")) {
    const figure = live.figures[box.dataset.figure];
    box.hidden = false;
    const [traces, page, after] = {map, stack, seeds, sparsity}[figure.kind](figure, box);
    await Plotly.react(box, traces, page, {responsive: true, displaylogo: false, scrollZoom: false,
      displayModeBar: small() ? false : "hover", modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]]});
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
