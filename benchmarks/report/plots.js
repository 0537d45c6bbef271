// Sweep curves and distributions, for the metric that is chosen.
const CONFIG = { responsive: true, displayModeBar: false };
const FONT = { family: "system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif", size: 13, color: look("ink") };
const GRID = { gridcolor: look("grid"), linecolor: look("rule"), zeroline: false };

function layoutOf(x, y, more = {}) {
  return {
    font: FONT, margin: { l: 62, r: 12, t: 34, b: 48 }, hovermode: "closest", paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    legend: { orientation: "h", traceorder: "normal", y: 1.02, yanchor: "bottom", x: 0 },
    xaxis: { title: { text: x }, ...GRID, ...more.xaxis },
    yaxis: { title: { text: y }, ...GRID, ...more.yaxis },
    ...more.rest,
  };
}

// A legend has up to a row for each name: the plot below it keeps its height.
function roomFor(home, traces) {
  home.style.height = `${310 + 19 * traces.filter((trace) => trace.showlegend !== false).length}px`;
}

const faint = (colour, share) => {
  const [r, g, b] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return `rgba(${r},${g},${b},${share})`;
};

function chooser(label, options, changed) {
  const select = make("select", {}, ...options.map(([value, text]) => make("option", { value }, text)));
  select.addEventListener("change", () => changed(select.value));
  return make("label", {}, `${label} `, select);
}

function metricsIn(present) {
  return Object.entries(data.metrics).filter(([name]) => present(name));
}

const SYMBOLS = ["circle", "square", "diamond", "triangle-up", "cross", "x", "star"];

// Where lines meet, the last one is seen, and those before it on both sides of it.
function curveTraces(curve, metric) {
  const traces = [];
  const places = curve.lines.flatMap((line) => (line.metrics[metric] || [[]])[0]).filter((x) => x !== null);
  const ends = [Math.min(...places), Math.max(...places)];
  for (const [place, line] of curve.lines.entries()) {
    if (!line.metrics[metric]) continue;
    const width = 2 + 1.5 * Math.min(curve.lines.length - 1 - place, 3);
    const [x, middle, low, high] = line.metrics[metric];
    if (x.includes(null)) {
      if (low[0] !== null) {
        traces.push({ x: [...ends, ...[...ends].reverse()], y: [low[0], low[0], high[0], high[0]], fill: "toself",
          fillcolor: faint(line.colour, 0.15), line: { width: 0 }, hoverinfo: "skip", showlegend: false, mode: "lines" });
      }
      traces.push({ x: ends, y: [middle[0], middle[0]], name: line.name, mode: "lines", line: { color: line.colour, dash: "dash" } });
      continue;
    }
    const reach = (end) => end.map((value, i) => (value === null || value === middle[i] ? null : Math.abs(value - middle[i])));
    traces.push({ x, y: middle, name: line.name, mode: "lines+markers", line: { color: line.colour, dash: line.dash, width },
      marker: { symbol: SYMBOLS[place % SYMBOLS.length], size: 6 + width },
      error_y: { type: "data", symmetric: false, array: reach(high), arrayminus: reach(low), thickness: 1.2, width: 4 } });
  }
  return [traces, ends[0] > 0 && ends[1] >= 10 * ends[0] ? "log" : "linear"];
}

function sweepPlots() {
  const home = part("sweep");
  const plots = data.curves.map(() => make("div", { class: "plot" }));
  const draw = (metric) => data.curves.forEach((curve, i) => {
    const [traces, type] = curveTraces(curve, metric);
    const ticks = [...new Set(traces.flatMap((trace) => trace.x))];
    const axis = ticks.length <= 10 ? { type, tickvals: ticks, ticktext: ticks.map(String) } : { type };
    roomFor(plots[i], traces);
    Plotly.react(plots[i], traces, layoutOf(curve.key, `median of ${data.metrics[metric]}`,
      { xaxis: axis, yaxis: { rangemode: "tozero" } }), CONFIG);
  });
  const metrics = metricsIn((name) => data.curves.some((curve) => curve.lines.some((line) => name in line.metrics)));
  home.append(make("div", { class: "controls" }, chooser("Metric", metrics, draw)),
    make("div", { class: "plots" }, ...plots),
    make("p", { class: "note" }, `Medians over trials. ${data.summary.note}`));
  draw(metrics[0][0]);
}

function distributionTraces(panel, metric) {
  const shares = [];
  const boxes = [];
  for (const one of panel.series) {
    if (!one.values[metric]) continue;
    const { colour, dash } = seriesOf(one.label);
    const known = one.values[metric].map((value, i) => [value, one.names[i]]).filter(([value]) => value !== null);
    const sorted = [...known].sort((a, b) => a[0] - b[0]);
    shares.push({ x: [sorted[0][0], ...sorted.map(([value]) => value)], name: one.label, mode: "lines",
      y: [0, ...sorted.map((_, i) => (i + 1) / one.all)], line: { color: colour, dash, shape: "hv" } });
    boxes.push({ x: known.map(([value]) => value), text: known.map(([, text]) => text), name: one.label, type: "box",
      orientation: "h", boxpoints: known.length <= 500 ? "all" : "outliers", jitter: 0.4, pointpos: 0, marker: { color: colour, size: 4, opacity: 0.6 },
      line: { color: colour, width: 1.5 }, hovertemplate: "%{text}: %{x}<extra></extra>" });
  }
  return [shares, boxes.reverse()];
}

function distributionPlots() {
  const home = part("distributions");
  const metrics = metricsIn((name) => data.panels.some((p) => p.series.some((one) => name in one.values)));
  if (!metrics.length) {
    home.hidden = true;
    return;
  }
  const [shares, boxes] = [make("div", { class: "plot" }), make("div", { class: "plot" })];
  const choice = { metric: metrics[0][0], panel: 0 };
  const draw = () => {
    const [steps, spread] = distributionTraces(data.panels[choice.panel], choice.metric);
    const heading = data.metrics[choice.metric];
    [shares, boxes].forEach((home) => roomFor(home, steps));
    Plotly.react(shares, steps, layoutOf(heading, "share of trials", { xaxis: { rangemode: "tozero" }, yaxis: { range: [0, 1.01] } }), CONFIG);
    Plotly.react(boxes, spread, layoutOf(heading, "", { xaxis: { rangemode: "tozero" },
      yaxis: { automargin: true }, rest: { showlegend: false } }), CONFIG);
  };
  const panels = data.panels.map((panel, i) => [i, panel.title]);
  home.append(make("div", { class: "controls" },
    chooser("Metric", metrics, (value) => { choice.metric = value; draw(); }),
    panels.length > 1 ? chooser("Variant", panels, (value) => { choice.panel = Number(value); draw(); }) : null),
    make("div", { class: "plots" }, shares, boxes),
    make("p", { class: "note" }, "Left: the share of trials up to each value; failed trials count as never. Right: each point is a trial."));
  draw();
}

fill("sweep", sweepPlots);
fill("distributions", distributionPlots);
