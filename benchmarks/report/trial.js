// One section a trial: the scene at the time of a slider, and curves with a cursor.
const STEP_MS = 100;
const players = [];

function trialArticle(trial, number) {
  const scene = make("div", { class: "plot scene" });
  const legend = make("div", { class: "legend" });
  const charts = Object.fromEntries(["error", "nees", "offset"].map((name) => [name, make("div", { class: "plot" })]));
  const last = Math.max(trial.time.length - 1, 0);
  const slider = make("input", { type: "range", min: 0, max: last, value: last, step: 1, "aria-label": trial.counts ?? "time" });
  const moment = make("output", {});
  const play = make("button", { type: "button", title: "space; arrows step" }, "Play");
  const [far, all] = [0, 1].map(() => make("input", { type: "checkbox" }));
  all.checked = Boolean(trial.at_once);
  const shows = Boolean(trial.scene.box);
  const article = make("article", {},
    trial.label && !data.single ? make("h3", {}, headingOf(trial, number)) : null,
    trial.label && !data.single ? make("p", {}, `${data.worst.heading}: ${shown(trial.value)}`) : null,
    trial.note ? make("p", { class: "note" }, trial.note) : null,
    last > 0 ? make("div", { class: "controls" }, play, slider, moment,
      trial.scene.vts ? make("label", {}, far, " zoom out to all virtual transmitters") : null,
      trial.scene.rays?.length ? make("label", {}, all, " all rays at once") : null) : null,
    shows ? scene : null, shows ? legend : null,
    trial.estimates.length ? make("div", { class: "plots three" }, ...Object.values(charts)) : null,
    trial.rows && !data.single ? make("details", {}, make("summary", {}, "All metrics of this trial"), trialTable(trial)) : null);
  const player = { article, trial, last, parts: { scene, legend, charts, slider, moment, play, far, all }, shows, step: last };
  players.push(player);
  return player;
}

const headingOf = (trial, number) => `${number + 1}. ${trial.label}, trial ${trial.trial}, seed ${trial.seed}`
  + (trial.settings ? `, ${trial.settings}` : "");

function trialTable(trial) {
  const keys = [...new Set(trial.rows.flatMap((row) => Object.keys(row.values)))];
  const lines = trial.rows.map((row) => [
    { key: row.label, node: named(row.label) },
    ...keys.map((key) => ({ key: row.values[key] ?? null, node: row.status === "ok" ? shown(row.values[key]) : "failed" })),
  ]);
  return sortable([{ text: "estimator" }, ...keys.map((key) => data.columns[key])], lines, 1);
}

// Draws a section once it is looked at, and gives it what moves it.
function begin(player) {
  if (player.go) return;
  const { trial, parts, last } = player;
  const moving = player.shows ? drawScene(parts.scene, parts.legend, trial) : null;
  const cursors = trial.estimates.length ? drawCharts(parts.charts, trial) : [];
  const show = () => {
    const { step } = player;
    parts.slider.value = step;
    parts.moment.textContent = trial.counts ? `${trial.counts} ${trial.time[step]}` : `t = ${(trial.time[step] ?? 0).toFixed(1)} s`;
    if (moving) moving(step, parts.all.checked);
    for (const chart of cursors) Plotly.relayout(chart, { "shapes[0].x0": trial.time[step], "shapes[0].x1": trial.time[step] });
  };
  // Drags come faster than scenes are drawn: only the last one of a frame counts.
  let asked = false;
  player.go = (step) => {
    player.step = Math.max(0, Math.min(last, step));
    if (!asked) requestAnimationFrame(() => { asked = false; show(); });
    asked = true;
  };
  parts.slider.addEventListener("input", () => seek(player, Number(parts.slider.value)));
  parts.play.addEventListener("click", () => toggle(player));
  parts.all.addEventListener("change", () => player.go(player.step));
  parts.far.addEventListener("change", () => Plotly.relayout(parts.scene, extentOf(trial, parts.far.checked)));
  show();
}

function toggle(player) {
  const stop = () => {
    clearInterval(player.timer);
    player.timer = null;
    player.parts.play.textContent = "Play";
    link(player);
  };
  if (player.timer) {
    stop();
    return;
  }
  player.parts.all.checked = false;
  if (player.step === player.last) player.go(0);
  player.parts.play.textContent = "Pause";
  player.timer = setInterval(() => (player.step === player.last ? stop() : player.go(player.step + 1)), STEP_MS);
}

function seek(player, step) {
  player.parts.all.checked = false;
  player.go(step);
  clearTimeout(player.linking);
  player.linking = setTimeout(() => link(player), 300);
}

// A link to a moment, #trial=3&t=120: the number of the trial and the time; kept in the address for sending it around.
function link(player) {
  const same = players.filter((one) => one.trial.trial === player.trial.trial);
  const pairs = { trial: player.trial.trial ?? 0, ...(same.length > 1 ? { section: players.indexOf(player) + 1 } : {}), t: player.trial.time[player.step] };
  history.replaceState(null, "", `#${new URLSearchParams(pairs)}`);
}

function follow() {
  const asked = new URLSearchParams(location.hash.slice(1));
  if (!asked.has("trial")) return;
  const player = players[Number(asked.get("section")) - 1]
    ?? players.find((one) => String(one.trial.trial ?? 0) === asked.get("trial"));
  if (!player) return;
  begin(player);
  const away = player.trial.time.map((time) => Math.abs(time - Number(asked.get("t"))));
  if (asked.has("t")) seek(player, away.indexOf(Math.min(...away)));
  player.article.scrollIntoView();
}

// Space plays what is in the middle of the window, arrows step through it.
function onKey(event) {
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.closest?.("select, button, summary, .scroll, input[type=checkbox]")) return;
  const middle = innerHeight / 2;
  const there = (one) => one.article.getBoundingClientRect().top <= middle && one.article.getBoundingClientRect().bottom >= middle;
  const player = players.find(there);
  if (!player?.go || !player.last) return;
  const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (event.key === " ") toggle(player);
  else if (step) seek(player, player.step + step * (event.shiftKey ? 10 : 1));
  else return;
  event.preventDefault();
}

function trialSections() {
  const home = part("trials");
  if (data.worst && !data.single) {
    home.append(make("p", { class: "note" }, `Ranked by ${data.worst.heading}. An estimate's virtual transmitters stand where they`
      + " ended and appear when first measured."));
  }
  const moves = data.trials.some((trial) => trial.time.length > 1);
  home.append(make("p", { class: "note" }, "Drag to turn, scroll to zoom."
    + (moves ? " Space plays, arrows step. The address links to the moment that is shown." : "")));
  const seen = new IntersectionObserver((entries) => entries.filter((one) => one.isIntersecting).forEach((one) => {
    seen.unobserve(one.target);
    begin(players.find((player) => player.article === one.target));
  }), { rootMargin: "300px" });
  data.trials.map(trialArticle).forEach(({ article }) => {
    home.append(article);
    seen.observe(article);
  });
  addEventListener("keydown", onKey);
  addEventListener("hashchange", follow);
  follow();
}

fill("trials", trialSections);
// Plots take their colours when they are drawn.
scheme.addEventListener("change", () => location.reload());
