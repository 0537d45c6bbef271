// Curves of a trial over time, with a cursor: errors, NEES, clock offsets.
// Between these a consistent NEES with two degrees of freedom stays for 95 % of the time.
const NEES_BAND = [0.0506, 7.378];
const DECADES = [0.001, 0.01, 0.1, 1, 10, 100, 1000, 10000, 100000, 1000000];

// Curves of other labels that are nowhere further from each other than an eye tells are said to coincide.
const COINCIDES = 0.005;
function alike(one, other) {
  if (one.length !== other.length) return false;
  const known = one.map((value, i) => [value, other[i]]).filter(([a, b]) => a !== null && b !== null);
  const all = known.flat();
  const span = all.reduce((most, value) => Math.max(most, value), -Infinity) - all.reduce((least, value) => Math.min(least, value), Infinity);
  return known.length > 0 && known.every(([a, b]) => Math.abs(a - b) <= COINCIDES * span);
}

function drawCharts(charts, trial) {
  const { time, estimates, bound, scene } = trial;
  const line = (one, y, more = {}) => ({ x: time, y, name: one.label, mode: "lines",
    line: { color: seriesOf(one.label).colour, dash: seriesOf(one.label).dash, width: 1.6 }, ...more });
  const cursor = { type: "line", xref: "x", yref: "paper", y0: 0, y1: 1, x0: 0, x1: 0, line: { color: look("soft"), width: 1, dash: "dot" } };
  const drawn = [];
  const draw = (home, traces, layout) => {
    if (traces.length) {
      roomFor(home, traces);
      Plotly.newPlot(home, traces, layout, CONFIG);
      drawn.push(home);
    } else home.hidden = true;
  };
  const having = estimates.filter((one) => one.error.length);
  const errors = having.map((one) => line(one, one.error, coinciding(one, having, (other) => other.error)));
  if (bound.length) errors.push({ x: time, y: bound, name: "bound", mode: "lines", line: { color: look("soft"), dash: "dash", width: 1.4 } });
  draw(charts.error, errors, layoutOf("time (s)", "horizontal error (m)", { yaxis: { rangemode: "tozero" }, rest: { shapes: [cursor] } }));
  const band = { type: "rect", xref: "paper", x0: 0, x1: 1, y0: NEES_BAND[0], y1: NEES_BAND[1], fillcolor: "#999999", opacity: 0.2, line: { width: 0 }, layer: "below" };
  const consistent = estimates.filter((one) => one.nees.length);
  const cut = (one) => one.nees.map((v) => (v === null ? null : Math.max(v, 1e-3)));
  draw(charts.nees, consistent.map((one) => line(one, cut(one), coinciding(one, consistent, (other) => cut(other).map((v) => v && Math.log(v))))),
    layoutOf("time (s)", "NEES (grey: 95 %)", { yaxis: { type: "log", tickvals: DECADES, ticktext: DECADES.map(String) }, rest: { shapes: [cursor, band] } }));
  draw(charts.offset, ...offsetChart(estimates, time, scene, cursor, line));
  return drawn;
}

// Name and line of one that another one before it covers.
function coinciding(one, all, valuesOf) {
  const first = all.slice(0, all.indexOf(one)).find((other) => alike(valuesOf(other), valuesOf(one)));
  return first ? { name: `${one.label} (coincides with ${first.label})`, line: { color: seriesOf(one.label).colour, dash: "dot", width: 2.4 } } : {};
}

// Error of each site's clock offset, with the band of two claimed standard deviations; a row a site.
function offsetChart(estimates, time, scene, cursor, line) {
  const having = estimates.filter((one) => one.offset_error.length);
  const sites = Math.max(0, ...having.map((one) => one.offset_error.length));
  const traces = [];
  const layout = layoutOf("time (s)", "", { rest: { shapes: [cursor] } });
  for (let site = 0; site < sites; site += 1) {
    const axis = site ? String(site + 1) : "";
    const share = 1 / sites;
    const name = scene.sites ? scene.sites[site] : site + 1;
    layout[`yaxis${axis}`] = { ...layout.yaxis, domain: [1 - (site + 1) * share + 0.04, 1 - site * share - (site ? 0.02 : 0)],
      title: { text: `offset error ${name} (m)`, font: { size: 12 } }, automargin: true };
    for (const one of having) {
      const [error, std] = [one.offset_error[site], one.offset_std.length ? one.offset_std[site] : null];
      if (std) {
        const side = (sign) => error.map((value, i) => (value === null || std[i] === null ? null : value + sign * 2 * std[i]));
        traces.push({ x: time, y: side(-1), mode: "lines", line: { width: 0 }, yaxis: `y${axis}`, hoverinfo: "skip", showlegend: false });
        traces.push({ x: time, y: side(1), mode: "lines", line: { width: 0 }, yaxis: `y${axis}`, hoverinfo: "skip", showlegend: false,
          fill: "tonexty", fillcolor: faint(seriesOf(one.label).colour, 0.2) });
      }
      const covered = coinciding(one, having, (other) => other.offset_error.flat());
      traces.push(line(one, error, { ...covered, yaxis: `y${axis}`, showlegend: site === 0 }));
    }
  }
  layout.xaxis.anchor = sites > 1 ? `y${sites}` : "y";
  return [traces, layout];
}
