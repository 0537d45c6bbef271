// The scene in three dimensions: city, sites, drive, rays and virtual transmitters.
// Kinds of rays by number.
const RAY_KINDS = [["line of sight", "#444444"], ["one reflection", "#8C510A"], ["two reflections", "#DFA64D"], ["diffraction", "#B5179E"]];
const UNLIT = { hoverinfo: "skip", flatshading: true, lighting: { ambient: 1, diffuse: 0, specular: 0, roughness: 1, fresnel: 0 } };
const NOTHING = [[], [], []];

// Shades are worked out beforehand: the page's own light would colour neighbours in a plane differently.
function meshTrace({ bright, name, colour, ...mesh }) {
  const shade = (n) => `rgb(${colour.map((c) => Math.round(c * (0.62 + 0.38 * (n / 9))))})`;
  const shades = Array.from({ length: 10 }, (_, n) => shade(n));
  return { ...mesh, ...UNLIT, type: "mesh3d", facecolor: bright.map((n) => shades[n]), name, color: shades[6] };
}

const points3 = ([x, y, z], more) => ({ type: "scatter3d", x, y, z, hoverinfo: "name", ...more });
const lines3 = (name, points, color, width) => points3(points, { name, mode: "lines", line: { color, width } });
const markers3 = (name, points, color, size, symbol = "circle") => points3(points,
  { name, mode: "markers", marker: { color, size, symbol } });

function stillTraces({ scene, estimates }) {
  const along = scene.truth_name ? markers3 : lines3;
  return [
    ...(data.cities[scene.city]?.parts ?? []).map(meshTrace),
    ...(scene.sites.length ? [points3(scene.site_positions, { name: "sites", mode: "markers+text", text: scene.sites, textposition: "top center",
      textfont: { color: "#1b1b1b" }, marker: { color: "#D55E00", size: 5, symbol: "diamond" } })] : []),
    ...(scene.truth ? [along(scene.truth_name ?? "true drive", scene.truth, "#000000", scene.truth_name ? 2 : 5)] : []),
    ...(scene.reference ? [markers3("reference", scene.reference, "#000000", 2)] : []),
    ...estimates.map((one) => lines3(one.label, one.position, seriesOf(one.label).colour, 4)),
  ];
}

// What moves: each with what it shows at a step; at null, everything at once.
function movingTraces({ scene, estimates }) {
  const out = [];
  const moves = (trace, now) => out.push([trace, now]);
  RAY_KINDS.forEach(([name, colour], kind) => {
    if (scene.rays?.some((rays) => rays.some((ray) => ray[0] === kind))) moves(lines3(name, NOTHING, colour, 2), (step) => raysAt(scene, step, kind));
  });
  if (scene.measured) moves(lines3("measured paths", NOTHING, "#008B8B", 2), (step) => measuredAt(scene, estimates[0].position, step));
  if (scene.truth) moves(markers3(scene.truth_name ? "receiver" : "vehicle", NOTHING, "#000000", 5), (step) => at(scene.truth, step));
  if (scene.visible) moves(markers3("true virtual transmitters", NOTHING, "#000000", 5, "circle-open"), (step) => pick(scene.vts, scene.visible[step]));
  for (const one of estimates) {
    const { colour } = seriesOf(one.label);
    moves(markers3(`${one.label}: position`, NOTHING, colour, 5), (step) => at(one.position, step));
    if (one.first.length) moves(markers3(`${one.label}: virtual transmitters`, NOTHING, colour, 3, "diamond"),
      (step) => pick(one.vts, one.first.flatMap((first, v) => (first <= step ? [v] : []))));
  }
  if (scene.vehicles) moves(boxTrace(scene.vehicles.size.length), (step) => cornersOf(scene.vehicles, step));
  return out;
}

// Draws the scene; returns what moves it to a step, with the rays of all steps where `all` is true.
function drawScene(home, legend, trial) {
  const still = stillTraces(trial);
  const moving = movingTraces(trial);
  const traces = [...still, ...moving.map(([trace]) => trace)];
  const axis = (text, range) => ({ title: { text }, color: "#3c4248", gridcolor: "#d5dbe0", backgroundcolor: "#eef2f5", showspikes: false, range });
  const extent = extentOf(trial, false);
  Plotly.newPlot(home, traces, {
    font: { ...FONT, color: "#1b1b1b" }, margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", showlegend: false,
    scene: { aspectmode: "manual", aspectratio: extent["scene.aspectratio"], camera: { eye: { x: 0, y: -1.25, z: 1.2 }, center: { x: 0, y: -0.1, z: -0.1 } }, dragmode: "turntable",
      xaxis: axis("x (m)", extent["scene.xaxis.range"]), yaxis: axis("y (m)", extent["scene.yaxis.range"]), zaxis: axis("z (m)", extent["scene.zaxis.range"]) },
  }, CONFIG);
  drawLegend(home, legend, traces, still.length);
  const places = moving.map((_, i) => still.length + i);
  return (step, all) => {
    const now = moving.map(([trace, of]) => (all && trace.mode === "lines" ? everything(trial.time.length, of) : of(step)));
    Plotly.restyle(home, { x: now.map((p) => p[0]), y: now.map((p) => p[1]), z: now.map((p) => p[2]) }, places);
  };
}

// Names below the scene, as it has no room for them on a phone; each switches what it names.
function drawLegend(home, legend, traces, still) {
  traces.forEach((trace, i) => {
    if ((i < still && !trace.x.length) || trace.name.endsWith(": position")) return;
    const colour = trace.line?.color ?? trace.marker?.color ?? trace.color;
    const button = make("button", { type: "button", "aria-pressed": "true" },
      make("span", { class: "swatch", style: `background:${colour}` }), trace.name);
    button.addEventListener("click", () => {
      const on = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", on);
      Plotly.restyle(home, { visible: on }, [i]);
    });
    legend.append(button);
  });
}

// Boxes of other vehicles: eight corners each, four below and four above; two triangles a side, none below.
const BOX_SIDES = [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7], [4, 5, 6], [4, 6, 7]];
const BOX_SHADES = ["#5b6b8c", "#5b6b8c", "#4d5b78", "#4d5b78", "#5b6b8c", "#5b6b8c", "#4d5b78", "#4d5b78", "#7586ab", "#7586ab"];

function boxTrace(count) {
  const numbers = Array.from({ length: count }, (_, n) => 8 * n);
  const [i, j, k] = [0, 1, 2].map((c) => numbers.flatMap((first) => BOX_SIDES.map((side) => first + side[c])));
  return { type: "mesh3d", x: [], y: [], z: [], i, j, k, facecolor: numbers.flatMap(() => BOX_SHADES), name: "other vehicles",
    color: "#5b6b8c", ...UNLIT, hoverinfo: "name" };
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

const everything = (steps, of) => Array.from({ length: steps }, (_, step) => of(step)).reduce(
  (sum, one) => sum.map((column, c) => column.concat(one[c])), NOTHING);

// The rays of one kind at a step; null separates them.
function raysAt(scene, step, kind) {
  const lines = [[], [], []];
  for (const [own, site, ...middle] of scene.rays[step].filter((ray) => ray[0] === kind)) {
    lines.forEach((line, c) => {
      line.push(scene.site_positions[c][site]);
      for (let i = c; i < middle.length; i += 3) line.push(middle[i]);
      line.push(scene.truth[c][step], null);
    });
  }
  return lines;
}

// Measured paths, from the estimated position to where they point.
function measuredAt(scene, position, step) {
  const ends = scene.measured[step];
  return [0, 1, 2].map((c) => ends.flatMap((value, i) => (i % 3 === c ? [position[c][step], value, null] : [])));
}

// Ranges and aspect are fixed: what comes and goes must not move the city.
function extentOf(trial, far) {
  const { scene, estimates } = trial;
  const parts = data.cities[scene.city]?.parts ?? [];
  const heights = parts.flatMap((one) => one.z);
  const low = [scene.box[0][0], scene.box[1][0], 0];
  const high = [scene.box[0][1], scene.box[1][1], 0];
  const all = [scene.site_positions, scene.truth ?? NOTHING, ...(far ? [scene.vts ?? NOTHING, ...estimates.map((one) => one.vts)] : [])];
  for (const columns of [[[], [], heights], ...all]) {
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

