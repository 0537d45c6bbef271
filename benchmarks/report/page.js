// Tables and text. Text from results enters as text, never as markup.
const data = JSON.parse(document.getElementById("data").textContent);

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== undefined && value !== null) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

const part = (id) => document.getElementById(id);
const scheme = matchMedia("(prefers-color-scheme: dark)");
const look = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const seriesOf = (label) => data.series.find((one) => one.label === label);

function named(label) {
  const one = seriesOf(label);
  const swatch = make("span", { class: "swatch", style: `background:${one.colour}` });
  return make("span", {}, swatch, one.oracle ? `${label} (oracle)` : label);
}

function shown(value) {
  if (value === null || value === undefined) return "–";
  if (typeof value !== "number") return String(value);
  const size = Math.abs(value);
  if (size !== 0 && size < 0.01) return value.toPrecision(2);
  return size >= 1000 ? value.toFixed(0) : size >= 100 ? value.toFixed(1) : value.toFixed(size < 1 ? 3 : 2);
}

// Long keys may break after their dots.
const breakable = (text) => text.split(/(?<=[._])/).flatMap((piece) => [piece, make("wbr")]);

// What stands before a value on a narrow screen, where a row of a table is a list.
const withUnit = (heading) => (heading.unit ? `${heading.text} (${heading.unit})` : heading.text);

// A table whose columns sort; each line is a list of cells {key, node}, key being what is compared.
function sortable(headings, lines, words) {
  const body = make("tbody");
  const head = make("tr");
  const fill = (sorted) => body.replaceChildren(...sorted.map((line) => line.row));
  const rows = lines.map((cells) => ({
    cells,
    row: make("tr", {}, ...cells.map((cell, i) =>
      make("td", { class: i < words ? "word" : null, "data-heading": withUnit(headings[i]) }, cell.node))),
  }));
  headings.forEach((heading, column) => {
    const button = make("button", { type: "button" }, ...breakable(heading.text));
    const unit = heading.unit ? make("span", { class: "unit" }, heading.unit) : null;
    const cell = make("th", { scope: "col", title: heading.title, class: column < words ? "word" : null }, button, unit);
    button.addEventListener("click", () => {
      const rising = cell.getAttribute("aria-sort") !== "ascending";
      for (const other of head.children) other.removeAttribute("aria-sort");
      cell.setAttribute("aria-sort", rising ? "ascending" : "descending");
      fill([...rows].sort((a, b) => compare(a.cells[column].key, b.cells[column].key, rising)));
    });
    head.append(cell);
  });
  fill(rows);
  return scrolled(make("table", {}, make("thead", {}, head), body));
}

// What is missing comes last, whichever way the column is sorted.
function compare(a, b, rising) {
  if (a === null || b === null) return (a === null) - (b === null);
  const order = typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b));
  return rising ? order : -order;
}

function summaryTable() {
  const { keys, headings, lines } = data.summary;
  const cells = (line) => [
    ...line.settings.map((value) => ({ key: value, node: typeof value === "number" ? String(Number(value.toPrecision(6))) : shown(value) })),
    { key: line.label, node: named(line.label) },
    ...line.cells.map((cell) => ({ key: cell ? cell[0] : null, node: estimate(cell) })),
    { key: line.ok, node: line.ok === line.all ? String(line.ok) : `${line.ok}/${line.all}` },
  ];
  const all = [
    ...keys.map((text) => ({ text })),
    { text: "estimator" },
    ...headings,
    { text: "trials ok", title: "trials that succeeded, of how many where some failed" },
  ];
  part("summary").append(
    sortable(all, lines.map(cells), keys.length + 1),
    make("p", { class: "note" }, (data.single ? "" : `${data.summary.note} `)
      + "Position errors are horizontal, absolute, not aligned. Click a heading to sort."
      + (data.series.some((one) => one.oracle) ? " Oracle: was shown the truth." : "")),
  );
}

function estimate(cell) {
  if (!cell) return "–";
  const [value, low, high] = cell;
  const below = low === null ? null : make("span", { class: "interval" }, `${shown(low)} – ${shown(high)}`);
  return make("span", {}, shown(value), below);
}

const scrolled = (child) => make("div", { class: "scroll", tabindex: "0" }, child);

function ranksPicture() {
  part("ranks").append(scrolled(make("img", { src: data.ranks.image, alt: "mean ranks and critical differences" })),
    make("p", {}, `Significant differences: ${data.ranks.significant_pairs.join("; ")}.`),
    make("p", { class: "note" }, "Ranks of the position RMSE over trials, 1 the best, oracles aside; a bar joins what Nemenyi's test cannot"
      + " distinguish. Pairs are compared by Wilcoxon's signed-rank test, corrected for all pairs by Holm's method, at 5 %."));
}

function stanfordPicture() {
  part("integrity").append(scrolled(make("img", { src: data.integrity, alt: "protection level against error, an estimator a panel" })),
    make("p", { class: "note" }, "Every snapshot: above the diagonal the protection level holds, below it the estimator misleads. Orange: the"
      + " alert limit; red: hazardous. A drive is one sample: cellslam integrity has limits over independent drives."));
}

function failedTable() {
  const { count, rows } = data.failed;
  if (!count) {
    part("failed").append(make("p", {}, "None."));
    return;
  }
  const head = ["estimator", "trial", "seed", "error"].map((text) => make("th", { class: "word" }, text));
  const body = rows.map((row) => make("tr", {},
    make("td", { class: "word" }, row.estimator), make("td", { class: "word" }, String(row.trial)),
    make("td", { class: "word" }, String(row.seed)), make("td", { class: "text" }, row.error,
      row.traceback ? make("details", {}, make("summary", {}, "details"), make("pre", {}, row.traceback)) : null)));
  const more = count > rows.length ? `The first ${rows.length} of ${count}.` : "";
  part("failed").append(scrolled(make("table", {}, make("thead", {}, make("tr", {}, ...head)), make("tbody", {}, ...body))),
    make("p", { class: "note" }, more));
}

function provenanceText() {
  const { runs, rows, seeds, trials, worlds, more_worlds: more, options, cellslam } = data.provenance;
  const range = trials[0] === trials[1] ? `trial ${trials[0]}` : `trials ${trials[0]} to ${trials[1]}`;
  const folded = (title, value) => make("details", {}, make("summary", {}, title),
    make("pre", {}, JSON.stringify(value, null, 1)));
  const versions = (one) => Object.entries(one.versions).map(([name, text]) => `${name} ${text}`).join(", ");
  part("provenance").append(make("div", {},
    make("p", {}, `${rows} rows, root seed ${seeds.join(", ")}, ${range}. Report by cellslam ${cellslam}.`),
    make("h3", {}, "Commands"),
    ...runs.map((one) => make("div", {}, make("pre", {}, one.command),
      make("p", { class: "note" }, `${one.started} on ${one.host}: ${versions(one)}`))),
    make("h3", {}, "Resolved scenarios and options"),
    ...worlds.map((world, i) => folded(`${world.name}${worlds.length > 1 ? `, variant ${i + 1}` : ""}`, world)),
    more ? make("p", { class: "note" }, `and ${more} more variants in the store`) : null,
    ...options.filter((one) => one.options).map((one) => folded(one.estimator, one.options)),
  ));
}

function contents() {
  part("lead").textContent = data.lead ?? `${data.provenance.rows} rows: ${data.series.map((one) => one.label).join("; ")}.`;
  const filled = [...document.querySelectorAll("section, footer")].filter((one) => !one.hidden);
  if (filled.length < 2) return;
  document.querySelector("nav").append(
    ...filled.map((one) => make("a", { href: `#${one.id}` }, one.querySelector("h2").textContent)));
}

// What a section needs of the content; without it the section is not there.
const NEEDS = { summary: data.summary, ranks: data.ranks, integrity: data.integrity, sweep: data.curves?.length, distributions: data.panels,
  trials: data.trials.length, failed: data.failed, provenance: data.provenance };
for (const [id, needed] of Object.entries(NEEDS)) part(id).hidden = !needed;
const fill = (id, how) => part(id).hidden || how();

part("trials").querySelector("h2").textContent = data.heading;
if (data.single) document.querySelector("main").prepend(part("trials"));
fill("summary", summaryTable);
fill("ranks", ranksPicture);
fill("integrity", stanfordPicture);
fill("failed", failedTable);
fill("provenance", provenanceText);
contents();
// Plots come once what is to be read has been painted: their scripts take a second.
const opened = (packed) => new Response(new Blob([Uint8Array.from(atob(packed), (c) => c.charCodeAt(0))]).stream()
  .pipeThrough(new DecompressionStream("gzip"))).text();
const run = (text) => document.body.append(make("script", {}, text));

addEventListener("DOMContentLoaded", () => requestAnimationFrame(() => setTimeout(async () => {
  run(await opened(document.querySelector("script[type='text/gzip']").textContent));
  run(document.querySelector("script[type='text/plain']").textContent);
})));
