// The fleet's page: the table of boards. drifts.js draws drift charts, groups.js the tables of rigs, lots
// and sites. data.js calls FLEET(data) once; history/NN.js calls HISTORY(nn, boards and groups).
"use strict";

const ROW_PX = 27, SPARE = 12;
const by = (id) => document.getElementById(id);
let data, boards, shown = [], order = { key: "id", down: false }, opened = -1, column = "scale_z";
const histories = new Map(), waiting = new Map();

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value !== null && value !== false) made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

const text = (coded, at) => coded.names[coded.of[at]];
const count = (n, singular, plural) => `${n.toLocaleString("en")} ${n === 1 ? singular : plural || singular + "s"}`;
const label = (name) => data.labels[data.parameters.indexOf(name)];
const factorOf = (name) => data.factors[data.parameters.indexOf(name)];
const unitOf = (name) => data.units[data.parameters.indexOf(name)];
// A value in SI units as it is shown, in the parameter's unit.
const scaled = (value, name) => value === null || value === undefined ? null : value * factorOf(name);
const withUnit = (text, name) => unitOf(name) ? `${text} ${unitOf(name)}` : text;
const day = (seconds) => seconds === null ? "–" : new Date(seconds * 1000).toISOString().slice(0, 10);
const number = (value, digits = 5) => value === null || value === undefined ? "–"
  : value !== 0 && Math.abs(value) < 1e-5 ? Number(value).toExponential(digits - 1) : Number(value).toPrecision(digits);

// key, heading, cell text, whether it is a number, sort key (names are sorted already)
const COLUMN_OF_VALUE = 9;
const COLUMNS = [
  ["id", "board", (at) => boards.id[at], false, (at) => at],
  ["verdict", "verdict", verdictOf, false, (at) => boards.verdict.of[at] + (boards.drift[at] ? 0.5 : 0)],
  ...["sensor", "rig", "lot", "site"].map((name) => [name, name, (at) => text(boards[name], at), false, (at) => boards[name].of[at]]),
  ["version", "version", (at) => boards.version[at], true, (at) => boards.version[at]],
  ["start", "measured", (at) => boards.start[at], true, (at) => boards.start[at]],
  ["drift", "drift, σ", (at) => boards.drift[at] && boards.drift[at][0], true, (at) => boards.drift[at] ? Math.abs(boards.drift[at][0]) : 0],
  ["value", "", (at) => boards.value[column][at], true, (at) => boards.value[column][at]],
];

window.FLEET = (given) => {
  data = given; boards = given.boards;
  by("made").textContent = `${count(boards.id.length, "board")}, ${count(data.versions, "version")}, ` +
    `${count(data.nights, "night")}; written ${data.made} by Gyrorig ${data.software}`;
  drawTiles(); drawAlerts(); drawGroups(); drawKinds(); drawHead();
  const choice = by("column");
  for (const name of data.parameters) choice.append(element("option", { value: name }, label(name)));
  choice.value = column;
  choice.addEventListener("change", () => { column = choice.value; drawHead(); refresh(); });
  let soon = 0;
  by("search").addEventListener("input", () => { clearTimeout(soon); soon = setTimeout(refresh, 60); });
  by("rows").addEventListener("scroll", () => requestAnimationFrame(drawRows));
  by("rows").addEventListener("keydown", moveByKey);
  window.addEventListener("hashchange", openFromHash);
  refresh();
  openFromHash();
  document.body.dataset.ready = "yes";
};

window.HISTORY = (shard, entries) => {
  histories.set(shard, entries);
  for (const done of waiting.get(shard) || []) done(entries);
  waiting.delete(shard);
};

function drawTiles() {
  const boardsWith = (verdict) => boards.verdict.of.filter((at) => boards.verdict.names[at] === verdict).length;
  const tiles = [
    ["boards", boards.id.length, ""],
    ["good", boardsWith("good"), "verdict:good"],
    ["limited", boardsWith("limited"), "verdict:limited"],
    ["refused", boardsWith("refused"), "verdict:refused"],
    ["drifting", boards.drift.filter(Boolean).length, "is:drifting"],
    ["outliers", boards.outlier.filter(Boolean).length, "is:outlier"],
  ];
  for (const [name, value, filter] of tiles)
    by("tiles").append(element("button", { class: "tile", onclick: () => search(filter) },
      element("b", { class: ["good", "limited", "refused"].includes(name) ? name : null }, value.toLocaleString("en")), element("span", {}, name)));
}

function drawAlerts() {
  const list = by("alerts"), first = 8;
  if (!data.alerts.length) list.append(element("li", { class: "none" }, element("b", {}, "No alerts."), "No group and no board has shifted, no board is an outlier, and every recording gave a calibration."));
  const draw = (alert) => list.append(element("li", { class: alert.kind }, element("b", {}, capital(alert.finding)), alert.reason,
    alert.action ? element("div", { class: "soft" }, alert.action) : "",
    alert.filter ? element("button", { class: "link", onclick: () => search(alert.filter) }, "show the boards") : ""));
  data.alerts.slice(0, first).forEach(draw);
  if (data.alerts.length > first) {
    const more = element("button", { class: "link more", onclick: () => { more.remove(); data.alerts.slice(first).forEach(draw); } }, `${data.alerts.length - first} more`);
    list.append(more);
  }
}

// A parameter, such as scale.x, and the name of a rig, lot or site keep their spelling.
function capital(line) {
  return /^[a-z]+ /.test(line) ? line[0].toUpperCase() + line.slice(1) : line;
}

function drawKinds() {
  for (const kind of data.kinds) {
    const most = Math.max(...kind.bins.counts, 1), width = 100 / kind.bins.counts.length;
    const bars = kind.bins.counts.map((n, at) => `<rect x="${at * width}" width="${width * 0.9}" y="${40 - 38 * n / most}" height="${38 * n / most}"/>`).join("");
    const drawing = element("div");
    drawing.innerHTML = `<svg viewBox="0 0 100 41" preserveAspectRatio="none" height="60" role="img" aria-label="distribution">${bars}<line class="axis" x1="0" x2="100" y1="40" y2="40"/></svg>`;
    by("kinds").append(element("div", { class: "kind" }, element("b", {}, label(kind.parameter)), ` ${kind.sensor}`, drawing,
      element("small", {}, withUnit(`mean ${number(scaled(kind.mean, kind.parameter))} ± ${number(scaled(kind.mean_std, kind.parameter), 2)}, spread ${number(scaled(kind.spread, kind.parameter), 3)}`, kind.parameter)),
      element("small", {}, count(kind.boards, "board") + (kind.outliers ? `, ${count(kind.outliers, "outlier")}` : "") + (kind.prior ? `, ${kind.prior} known better from the fleet` : ""))));
  }
  if (!data.kinds.length) by("kinds").append(element("p", { class: "soft" }, "These statistics need eight boards with the same sensor."));
  by("offsets-section").hidden = !data.offsets.length;
  for (const line of data.offsets) by("offsets").append(element("li", {}, capital(line) + "."));
}

function drawHead() {
  COLUMNS[COLUMN_OF_VALUE][1] = label(column) + (unitOf(column) ? `, ${unitOf(column)}` : "");
  by("head").replaceChildren(...COLUMNS.map(([key, name, , numeric]) => element("button", {
    class: numeric ? "num" : null, role: "columnheader",
    "aria-sort": order.key === key ? (order.down ? "descending" : "ascending") : "none",
    onclick: () => { order = { key, down: order.key === key ? !order.down : numeric === true && key !== "value" }; drawHead(); refresh(); },
  }, name + (order.key === key ? (order.down ? " ↓" : " ↑") : ""))));
}

// All words have to match. A word with a colon is compared with one column, another with any text.
// Quotes keep a word together: lot:"lot 3".
function filter(words) {
  const tests = (words.toLowerCase().match(/(?:[^\s"]|"[^"]*")+/g) || []).map((quoted) => {
    const word = quoted.replace(/"/g, "");
    const [written, wanted] = word.includes(":") ? [word.slice(0, word.indexOf(":")), word.slice(word.indexOf(":") + 1)] : ["", word];
    const key = written === "trust" ? "verdict" : written;  // as in the index
    if (key === "is") return wanted === "drifting" ? (at) => boards.drift[at] !== null : ["outlier", "odd"].includes(wanted) ? (at) => boards.outlier[at] : wanted === "prior" ? (at) => boards.prior[at] !== 0 : () => false;
    if (key === "board") return (at) => boards.id[at].toLowerCase() === wanted;
    if (["verdict", "sensor", "rig", "lot", "site", "findings"].includes(key)) {
      const yes = boards[key].names.map((name) => name.toLowerCase() === wanted);
      return (at) => yes[boards[key].of[at]];
    }
    const coded = ["sensor", "rig", "lot", "site", "verdict"].map((name) => [boards[name].of, boards[name].names.map((known) => known.toLowerCase().includes(wanted))]);
    return (at) => boards.id[at].toLowerCase().includes(wanted) || coded.some(([of, yes]) => yes[of[at]]);
  });
  const matching = [];
  for (let at = 0; at < boards.id.length; at++) if (tests.every((test) => test(at))) matching.push(at);
  return matching;
}

function refresh() {
  shown = filter(by("search").value);
  const key = COLUMNS.find(([name]) => name === order.key)[4], sign = order.down ? -1 : 1;
  const keys = new Float64Array(boards.id.length);
  for (const at of shown) { const value = key(at); keys[at] = value === null ? Infinity : sign * value; }
  shown.sort((a, b) => keys[a] < keys[b] ? -1 : keys[a] > keys[b] ? 1 : a - b);  // unknown values last
  by("count").textContent = shown.length === boards.id.length ? "" : `${shown.length.toLocaleString("en")} of ${boards.id.length.toLocaleString("en")}`;
  by("space").style.height = `${shown.length * ROW_PX}px`;
  by("rows").style.height = `${Math.max(3, shown.length) * ROW_PX + 2}px`;  // the style sheet sets the maximum
  by("rows").scrollTop = 0;
  drawRows();
}

function drawRows() {
  const view = by("rows"), first = Math.max(0, Math.floor(view.scrollTop / ROW_PX) - SPARE);
  const last = Math.min(shown.length, first + Math.ceil(view.clientHeight / ROW_PX) + 2 * SPARE);
  by("window").style.top = `${first * ROW_PX}px`;
  if (!shown.length) { by("window").replaceChildren(element("div", { class: "empty" }, "No board matches.")); return; }
  by("window").replaceChildren(...shown.slice(first, last).map((at) => {
    const drift = boards.drift[at];
    return element("div", { class: at === opened ? "row open" : "row", role: "row", onclick: () => open(at) },
      element("span", { title: boards.id[at] }, boards.id[at], boards.outlier[at] ? element("b", { class: "flag", title: "outlier among boards of its kind" }, " ◆") : ""),
      verdictCell(at), element("span", {}, text(boards.sensor, at)), element("span", {}, text(boards.rig, at)),
      element("span", {}, text(boards.lot, at)), element("span", {}, text(boards.site, at)),
      element("span", { class: "num" }, boards.version[at]), element("span", { class: "num" }, day(boards.start[at])),
      element("span", { class: drift ? "num flag" : "num", title: drift ? data.labels[drift[1]] : null }, drift ? `${drift[0] > 0 ? "+" : ""}${drift[0]}` : ""),
      element("span", { class: "num" }, number(scaled(boards.value[column][at], column))));
  }));
}

// A drifting board is never shown in green, whatever its last calibration says.
function verdictOf(at) {
  return text(boards.verdict, at) + (boards.drift[at] ? ", drifting" : "");
}

function verdictCell(at) {
  return element("span", { class: boards.drift[at] ? "flag" : text(boards.verdict, at) }, verdictOf(at));
}

function search(words) {
  by("search").value = words;
  refresh();
  by("boards-title").scrollIntoView({ block: "start" });
  if (shown.length === 1) open(shown[0]);
}

function open(at) {
  opened = at;
  history.replaceState(null, "", `#${encodeURIComponent(boards.id[at])}`);
  drawRows();
  const panel = by("board"), file = data.up + boards.file[at];
  panel.hidden = false;
  panel.replaceChildren(
    element("button", { class: "link close", onclick: close, "aria-label": "close" }, "close"),
    element("h3", {}, boards.id[at]),
    element("p", {}, verdictCell(at), `, version ${boards.version[at]}, measured ${day(boards.start[at])}`),
    element("p", {}, element("a", { href: `${file}.report.html` }, "report"), " · ", element("a", { href: `${file}.yaml` }, "calibration")),
    element("p", { id: "versions" }),
    element("p", { class: "soft", id: "loading" }, "loading the history …"));
  if (matchMedia("(max-width:60rem)").matches) panel.scrollIntoView({ block: "start" });  // the panel is below the table
  load(boards.shard[at], (entries) => { if (opened === at) drawBoard(at, entries[boards.id[at]] || { points: [], std: [], shrunk: [] }); }, "loading");
}

function close() {
  opened = -1; by("board").hidden = true;
  history.replaceState(null, "", location.pathname + location.search);
  drawRows();
}

function load(shard, done, words) {
  if (histories.has(shard)) { done(histories.get(shard)); return; }
  if (waiting.has(shard)) { waiting.get(shard).push(done); return; }
  waiting.set(shard, [done]);
  const script = element("script", { src: `history/${shard}.js` });
  script.addEventListener("error", () => { waiting.delete(shard); const line = by(words); if (line) line.textContent = "The history is missing. Run gyrorig fleet again."; });
  document.head.append(script);
}

function openFromHash() {
  let wanted = "";
  try { wanted = decodeURIComponent(location.hash.slice(1)); } catch { return; } // not of this page
  const at = wanted ? boards.id.indexOf(wanted) : -1;
  if (at < 0 || at === opened) return;
  by("rows").scrollTop = Math.max(0, shown.indexOf(at) - 4) * ROW_PX;
  open(at);
}

function moveByKey(event) {
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (!step || !shown.length) return;
  event.preventDefault();
  const next = Math.min(shown.length - 1, Math.max(0, shown.indexOf(opened) + step));
  open(shown[next]);
  const view = by("rows"), top = next * ROW_PX;
  if (top < view.scrollTop) view.scrollTop = top;
  if (top + ROW_PX > view.scrollTop + view.clientHeight) view.scrollTop = top + ROW_PX - view.clientHeight;
}
