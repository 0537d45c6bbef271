// One section a trial: the scene in three dimensions at the time of a slider, and curves with a cursor.
const RAY_KINDS = [["line of sight", "#444444"], ["one reflection", "#8C510A"], ["two reflections", "#DFA64D"]];
// Between these a consistent NEES with two degrees of freedom stays for 95 % of the time.
const NEES_BAND = [0.0506, 7.378];

function trialArticle(trial, number) {
  const scene = make("div", { class: "plot scene" });
  const charts = Object.fromEntries(["error", "nees", "offset"].map((name) => [name, make("div", { class: "plot" })]));
  const last = Math.max(trial.time.length, (trial.scene.rays || []).length) - 1;
  const slider = make("input", { type: "range", min: 0, max: Math.max(last, 0), value: 0, step: 1, "aria-label": "time" });
  const said = make("output", {});
  const play = make("button", { type: "button" }, "Play");
  const far = make("input", { type: "checkbox" });
  const id = `trial-${number + 1}`;
  const article = make("article", { id },
    make("h3", {}, `${number + 1}. ${trial.label}, trial ${trial.trial}, seed ${trial.seed}`
      + (trial.settings ? `, ${trial.settings}` : "")),
    make("p", {}, `${data.worst.heading}: ${shown(trial.value)}`),
    trial.note ? make("p", { class: "note" }, trial.note) : null,
    trialTable(trial),
    last > 0 ? make("div", { class: "controls" }, play, slider, said,
      trial.scene.truth ? make("label", {}, far, " zoom out to all virtual transmitters") : null) : null,
    trial.scene.truth ? scene : null,
    last > 0 ? make("div", { class: "plots three" }, ...Object.values(charts)) : null);
  return { article, begin: () => last > 0 && beginTrial(trial, { scene, charts, slider, said, play, far }) };
}

function trialTable(trial) {
  const keys = [...new Set(trial.rows.flatMap((row) => Object.keys(row.values)))];
  const lines = trial.rows.map((row) => [
    { key: row.label, node: named(row.label) },
    ...keys.map((key) => ({ key: row.values[key] ?? null, node: row.status === "ok" ? shown(row.values[key]) : "failed" })),
  ]);
  return sortable([{ text: "estimator" }, ...keys.map((key) => data.columns[key])], lines, 1);
}

function beginTrial(trial, parts) {
  const state = { step: 0, wanted: null, timer: null };
  const moving = trial.scene.truth ? drawScene(parts.scene, trial) : null;
  const cursors = drawCharts(parts.charts, trial);
  const time = (step) => (trial.time.length ? trial.time[step] : step);
  const show = (step) => {
    state.step = step;
    parts.slider.value = step;
    parts.said.textContent = trial.time.length ? `t = ${time(step).toFixed(1)} s` : `step ${step}`;
    if (moving) moving(step);
    for (const chart of cursors) Plotly.relayout(chart, { "shapes[0].x0": time(step), "shapes[0].x1": time(step) });
  };
  // Drags come faster than scenes are drawn: only the last one of a frame counts.
  const ask = (step) => {
    if (state.wanted === null) requestAnimationFrame(() => { show(state.wanted); state.wanted = null; });
    state.wanted = step;
  };
  parts.slider.addEventListener("input", () => ask(Number(parts.slider.value)));
  parts.play.addEventListener("click", () => {
    if (state.timer) clearInterval(state.timer);
    state.timer = state.timer ? null : setInterval(() => ask((state.step + 1) % (Number(parts.slider.max) + 1)), 100);
    parts.play.textContent = state.timer ? "Pause" : "Play";
  });
  parts.far.addEventListener("change", () => Plotly.relayout(parts.scene, extentOf(trial, parts.far.checked)));
  show(Number(parts.slider.max));
}

// Shades are worked out beforehand: the page's own light would colour neighbours in a plane differently.
function meshTrace({ bright, ...mesh }, [red, green, blue], name) {
  const shades = Array.from({ length: 10 }, (_, n) => {
    const share = 0.62 + 0.38 * (n / 9);
    return `rgb(${[red, green, blue].map((c) => Math.round(c * share)).join(",")})`;
  });
  return { ...mesh, type: "mesh3d", facecolor: bright.map((n) => shades[n]), name, hoverinfo: "skip", flatshading: true,
    lighting: { ambient: 1, diffuse: 0, specular: 0, roughness: 1, fresnel: 0 } };
}

const points3 = ([x, y, z], more) => ({ type: "scatter3d", x, y, z, hoverinfo: "name", ...more });

function drawScene(home, trial) {
  const { scene, estimates } = trial;
  const city = data.cities[scene.city];
  const traces = [
    meshTrace(city.ground, [223, 227, 224], "ground"),
    meshTrace(city.buildings, [224, 214, 200], "buildings"),
    points3(scene.site_positions, { name: "sites", mode: "markers+text", text: scene.sites, textposition: "top center",
      marker: { color: "#D55E00", size: 5, symbol: "diamond" } }),
    points3(scene.truth, { name: "true drive", mode: "lines", line: { color: "#000000", width: 5 } }),
    ...estimates.map((one) => points3(one.position, { name: one.label, mode: "lines",
      line: { color: seriesOf(one.label).colour, width: 4 } })),
  ];
  const still = traces.length;
  const none = [[], [], []];
  traces.push(
    ...RAY_KINDS.map(([name, colour]) => points3(none, { name, mode: "lines", line: { color: colour, width: 2 } })),
    points3(none, { name: "vehicle", mode: "markers", marker: { color: "#000000", size: 5 } }),
    points3(none, { name: "true virtual transmitters", mode: "markers",
      marker: { color: "#000000", size: 5, symbol: "circle-open" } }),
    ...estimates.flatMap((one) => {
      const colour = seriesOf(one.label).colour;
      return [points3(none, { name: `${one.label}: position`, mode: "markers", showlegend: false, marker: { color: colour, size: 5 } }),
        points3(none, { name: `${one.label}: virtual transmitters`, mode: "markers", showlegend: one.first.length > 0,
          marker: { color: colour, size: 3, symbol: "diamond" } })];
    }),
    ...(scene.vehicles ? [boxTrace(scene.vehicles.size.length)] : []),
  );
  const axis = (text) => ({ title: { text }, backgroundcolor: "#eef2f5", showspikes: false });
  const extent = extentOf(trial, false);
  Plotly.newPlot(home, traces, {
    font: FONT, margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", showlegend: home.clientWidth > 600,
    legend: { x: 0, y: 1, bgcolor: "rgba(255,255,255,0.75)", font: { size: 12 } },
    scene: { aspectmode: "manual", aspectratio: extent["scene.aspectratio"], camera: { eye: { x: 0, y: -1.25, z: 1.2 }, center: { x: 0, y: -0.1, z: -0.1 } }, dragmode: "turntable",
      xaxis: { ...axis("x (m)"), range: extent["scene.xaxis.range"] },
      yaxis: { ...axis("y (m)"), range: extent["scene.yaxis.range"] },
      zaxis: { ...axis("z (m)"), range: extent["scene.zaxis.range"] } },
  }, CONFIG);
  const moving = traces.slice(still).map((_, i) => still + i);
  return (step) => {
    const now = [...raysAt(scene, step), at(scene.truth, step), pick(scene.vts, scene.visible[step]),
      ...estimates.flatMap((one) => [at(one.position, step), pick(one.vts, one.first.flatMap((first, v) => (first <= step ? [v] : [])))]),
      ...(scene.vehicles ? [cornersOf(scene.vehicles, step)] : [])];
    Plotly.restyle(home, { x: now.map((p) => p[0]), y: now.map((p) => p[1]), z: now.map((p) => p[2]) }, moving);
  };
}

// Boxes of other vehicles: eight corners each, four below and four above; two triangles a side, none below.
const BOX_SIDES = [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7], [4, 5, 6], [4, 6, 7]];
const BOX_SHADES = ["#5b6b8c", "#5b6b8c", "#4d5b78", "#4d5b78", "#5b6b8c", "#5b6b8c", "#4d5b78", "#4d5b78", "#7586ab", "#7586ab"];

function boxTrace(count) {
  const numbers = Array.from({ length: count }, (_, n) => 8 * n);
  const [i, j, k] = [0, 1, 2].map((c) => numbers.flatMap((first) => BOX_SIDES.map((side) => first + side[c])));
  return { type: "mesh3d", x: [], y: [], z: [], i, j, k, facecolor: numbers.flatMap(() => BOX_SHADES), name: "other vehicles",
    color: "#5b6b8c", showlegend: true, hoverinfo: "name", flatshading: true,
    lighting: { ambient: 1, diffuse: 0, specular: 0, roughness: 1, fresnel: 0 } };
}

function cornersOf({ size, poses }, step) {
  const columns = [[], [], []];
  poses[step].forEach(([x, y, ground, yaw], n) => {
    const [length, width, height] = size[n];
    for (const up of [0, height]) {
      for (const [a, b] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) {
        const [along, left] = [(a * length) / 2, (b * width) / 2];
        columns[0].push(x + Math.cos(yaw) * along - Math.sin(yaw) * left);
        columns[1].push(y + Math.sin(yaw) * along + Math.cos(yaw) * left);
        columns[2].push(ground + up);
      }
    }
  });
  return columns;
}

const at = (columns, step) => columns.map((column) => [column[step]]);
const pick = (columns, rows) => columns.map((column) => rows.map((row) => column[row]));

// The rays of a step by number of reflections; null separates them.
function raysAt(scene, step) {
  const kinds = RAY_KINDS.map(() => [[], [], []]);
  for (const [site, ...middle] of scene.rays[step]) {
    const lines = kinds[middle.length / 3];
    lines.forEach((line, c) => {
      line.push(scene.site_positions[c][site]);
      for (let i = c; i < middle.length; i += 3) line.push(middle[i]);
      line.push(scene.truth[c][step], null);
    });
  }
  return kinds;
}

// Ranges and aspect are fixed: what comes and goes must not move the city.
function extentOf(trial, far) {
  const { scene, estimates } = trial;
  const { z } = data.cities[scene.city].buildings;
  const low = [scene.box[0][0], scene.box[1][0], Math.min(0, ...data.cities[scene.city].ground.z)];
  const high = [scene.box[0][1], scene.box[1][1], 0];
  const all = [scene.site_positions, scene.truth, ...(far ? [scene.vts, ...estimates.map((one) => one.vts)] : [])];
  for (const columns of [[[], [], z], ...all]) {
    columns.forEach((column, c) => column.forEach((value) => {
      if (value === null) return;
      low[c] = Math.min(low[c], value);
      high[c] = Math.max(high[c], value);
    }));
  }
  const ranges = low.map((value, c) => [value - 2, high[c] + 5]);
  const sizes = ranges.map(([from, to]) => to - from);
  const ratio = sizes.map((size) => (2 * size) / Math.max(...sizes));
  return {
    "scene.xaxis.range": ranges[0], "scene.yaxis.range": ranges[1], "scene.zaxis.range": ranges[2],
    "scene.aspectratio": { x: ratio[0], y: ratio[1], z: ratio[2] },
  };
}

function drawCharts(charts, trial) {
  const { time, estimates, bound, scene } = trial;
  const line = (one, y, more = {}) => ({ x: time, y, name: one.label, mode: "lines",
    line: { color: seriesOf(one.label).colour, dash: seriesOf(one.label).dash, width: 1.6 }, ...more });
  const cursor = { type: "line", xref: "x", yref: "paper", y0: 0, y1: 1, x0: 0, x1: 0, line: { color: "#555555", width: 1, dash: "dot" } };
  const drawn = [];
  const draw = (home, traces, layout) => {
    if (traces.length) {
      Plotly.newPlot(home, traces, layout, CONFIG);
      drawn.push(home);
    } else home.hidden = true;
  };
  const errors = estimates.filter((one) => one.error.length).map((one) => line(one, one.error));
  if (bound.length) errors.push({ x: time, y: bound, name: "bound", mode: "lines", line: { color: "#999999", dash: "dash", width: 1.4 } });
  draw(charts.error, errors, layoutOf("time (s)", "horizontal error (m)", { yaxis: { rangemode: "tozero" }, rest: { shapes: [cursor] } }));
  const band = { type: "rect", xref: "paper", x0: 0, x1: 1, y0: NEES_BAND[0], y1: NEES_BAND[1], fillcolor: "#999999", opacity: 0.2, line: { width: 0 }, layer: "below" };
  draw(charts.nees, estimates.filter((one) => one.nees.length).map((one) => line(one, one.nees.map((v) => (v === null ? null : Math.max(v, 1e-3))))),
    layoutOf("time (s)", "NEES (grey: 95 %)", { yaxis: { type: "log", dtick: 1, exponentformat: "power" }, rest: { shapes: [cursor, band] } }));
  draw(charts.offset, ...offsetChart(estimates, time, scene, cursor, line));
  return drawn;
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
      traces.push(line(one, error, { yaxis: `y${axis}`, showlegend: site === 0 }));
    }
  }
  layout.xaxis.anchor = sites > 1 ? `y${sites}` : "y";
  return [traces, layout];
}

function worstTrials() {
  const home = part("worst");
  if (!data.trials.length) {
    home.hidden = true;
    return;
  }
  home.append(make("p", { class: "note" }, `Ranked by ${data.worst.heading}. The slider moves vehicle, rays and`
    + " virtual transmitters; an estimate's virtual transmitters stand where they ended and appear when first measured."));
  const seen = new IntersectionObserver((entries) => entries.filter((one) => one.isIntersecting).forEach((one) => {
    seen.unobserve(one.target);
    one.target.begin();
  }), { rootMargin: "300px" });
  data.trials.map(trialArticle).forEach(({ article, begin }) => {
    home.append(article);
    article.begin = begin;
    seen.observe(article);
  });
}

summaryTable();
ranksPicture();
sweepPlots();
distributionPlots();
worstTrials();
failedTable();
provenanceText();
contents();
