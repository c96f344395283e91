// The fleet's page: boards. drifts.js draws charts, groups.js lots and rigs. data.js calls FLEET(data)
// once; history/NN.js calls HISTORY(nn, boards and groups).
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
const day = (seconds) => seconds === null ? "–" : new Date(seconds * 1000).toISOString().slice(0, 10);
const number = (value, digits = 5) => value === null || value === undefined ? "–"
  : value !== 0 && Math.abs(value) < 1e-5 ? Number(value).toExponential(digits - 1) : Number(value).toPrecision(digits);

// key, heading, what is shown, whether it is a number, what it is sorted by: names come sorted
const COLUMNS = [
  ["id", "board", (at) => boards.id[at], false, (at) => at],
  ...["trust", "sensor", "rig", "lot", "site"].map((name) => [name, name, (at) => text(boards[name], at), false, (at) => boards[name].of[at]]),
  ["version", "version", (at) => boards.version[at], true, (at) => boards.version[at]],
  ["start", "measured", (at) => boards.start[at], true, (at) => boards.start[at]],
  ["drift", "drift, sd", (at) => boards.drift[at] && boards.drift[at][0], true, (at) => boards.drift[at] ? Math.abs(boards.drift[at][0]) : 0],
  ["value", "", (at) => boards.value[column][at], true, (at) => boards.value[column][at]],
];

window.FLEET = (given) => {
  data = given; boards = given.boards;
  by("made").textContent = `${boards.id.length.toLocaleString("en")} boards, ${data.versions.toLocaleString("en")} versions, ` +
    `${data.nights} nights; made ${data.made} by Gyrorig ${data.software}`;
  drawTiles(); drawWorries(); drawGroups(); drawKinds(); drawHead();
  const choice = by("column");
  for (const name of data.parameters) choice.append(element("option", { value: name }, name.replace(/_/g, " ")));
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

window.HISTORY = (shard, found) => {
  histories.set(shard, found);
  for (const done of waiting.get(shard) || []) done(found);
  waiting.delete(shard);
};

function drawTiles() {
  const count = (name) => boards.trust.of.filter((at) => boards.trust.names[at] === name).length;
  const tiles = [
    ["boards", boards.id.length, ""],
    ["good", count("good"), "trust:good"],
    ["limited", count("limited"), "trust:limited"],
    ["refused", count("refused"), "trust:refused"],
    ["drifting", boards.drift.filter(Boolean).length, "is:drifting"],
    ["odd", boards.odd.filter(Boolean).length, "is:odd"],
  ];
  for (const [name, value, find] of tiles)
    by("tiles").append(element("button", { class: "tile", onclick: () => search(find) },
      element("b", { class: ["good", "limited", "refused"].includes(name) ? name : null }, value.toLocaleString("en")), element("span", {}, name)));
}

function drawWorries() {
  const list = by("worries"), first = 8;
  if (!data.worries.length) list.append(element("li", { class: "none" }, element("b", {}, "Nothing stands out."), "No group and no board has moved, none is odd, and all work has its calibration."));
  const draw = (one) => list.append(element("li", { class: one.kind }, element("b", {}, one.what), one.why,
    one.do ? element("div", { class: "soft" }, one.do) : "",
    one.find ? element("button", { class: "link", onclick: () => search(one.find) }, "show the boards") : ""));
  data.worries.slice(0, first).forEach(draw);
  if (data.worries.length > first) {
    const more = element("button", { class: "link more", onclick: () => { more.remove(); data.worries.slice(first).forEach(draw); } }, `${data.worries.length - first} more`);
    list.append(more);
  }
}

function drawKinds() {
  for (const one of data.kinds) {
    const most = Math.max(...one.bins.counts, 1), width = 100 / one.bins.counts.length;
    const bars = one.bins.counts.map((n, at) => `<rect x="${at * width}" width="${width * 0.9}" y="${40 - 38 * n / most}" height="${38 * n / most}"/>`).join("");
    const drawing = element("div");
    drawing.innerHTML = `<svg viewBox="0 0 100 41" preserveAspectRatio="none" height="60" role="img" aria-label="distribution">${bars}<line class="axis" x1="0" x2="100" y1="40" y2="40"/></svg>`;
    by("kinds").append(element("div", { class: "kind" }, element("b", {}, one.parameter.replace(/_/g, " ")), ` ${one.sensor}`, drawing,
      element("small", {}, `mean ${number(one.mean)} ± ${number(one.mean_std, 2)}, spread ${number(one.spread, 3)}${one.unit}`),
      element("small", {}, `${one.boards.toLocaleString("en")} boards` + (one.odd ? `, ${one.odd} odd` : "") + (one.prior ? `, ${one.prior} say less than the fleet` : ""))));
  }
  if (!data.kinds.length) by("kinds").append(element("p", { class: "soft" }, "Eight boards of one sensor are needed."));
  by("same-section").hidden = !data.same.length;
  for (const line of data.same) by("same").append(element("li", {}, line[0].toUpperCase() + line.slice(1) + "."));
}

function drawHead() {
  COLUMNS[9][1] = column.replace(/_/g, " ");
  by("head").replaceChildren(...COLUMNS.map(([key, name, , numeric]) => element("button", {
    class: numeric ? "num" : null, role: "columnheader",
    "aria-sort": order.key === key ? (order.down ? "descending" : "ascending") : "none",
    onclick: () => { order = { key, down: order.key === key ? !order.down : numeric === true && key !== "value" }; drawHead(); refresh(); },
  }, name + (order.key === key ? (order.down ? " ↓" : " ↑") : ""))));
}

// Words are joined by "and"; a word with a colon asks one column, the others any of the texts. What is
// in quotes is one word: lot:"lot 3".
function filter(words) {
  const tests = (words.toLowerCase().match(/(?:[^\s"]|"[^"]*")+/g) || []).map((quoted) => {
    const word = quoted.replace(/"/g, "");
    const [key, wanted] = word.includes(":") ? [word.slice(0, word.indexOf(":")), word.slice(word.indexOf(":") + 1)] : ["", word];
    if (key === "is") return wanted === "drifting" ? (at) => boards.drift[at] !== null : wanted === "odd" ? (at) => boards.odd[at] : wanted === "prior" ? (at) => boards.prior[at] !== 0 : () => false;
    if (key === "board") return (at) => boards.id[at].toLowerCase() === wanted;
    if (["trust", "sensor", "rig", "lot", "site", "findings"].includes(key)) {
      const yes = boards[key].names.map((name) => name.toLowerCase() === wanted);
      return (at) => yes[boards[key].of[at]];
    }
    const coded = ["sensor", "rig", "lot", "site", "trust"].map((name) => [boards[name].of, boards[name].names.map((one) => one.toLowerCase().includes(wanted))]);
    return (at) => boards.id[at].toLowerCase().includes(wanted) || coded.some(([of, yes]) => yes[of[at]]);
  });
  const found = [];
  for (let at = 0; at < boards.id.length; at++) if (tests.every((test) => test(at))) found.push(at);
  return found;
}

function refresh() {
  shown = filter(by("search").value);
  const key = COLUMNS.find(([name]) => name === order.key)[4], sign = order.down ? -1 : 1;
  const keys = new Float64Array(boards.id.length);
  for (const at of shown) { const one = key(at); keys[at] = one === null ? Infinity : sign * one; }
  shown.sort((a, b) => keys[a] < keys[b] ? -1 : keys[a] > keys[b] ? 1 : a - b);  // unknown ones last
  by("count").textContent = shown.length === boards.id.length ? "" : `${shown.length.toLocaleString("en")} of ${boards.id.length.toLocaleString("en")}`;
  by("space").style.height = `${shown.length * ROW_PX}px`;
  by("rows").style.height = `${Math.max(3, shown.length) * ROW_PX + 2}px`;  // no more than the style allows
  by("rows").scrollTop = 0;
  drawRows();
}

function drawRows() {
  const view = by("rows"), first = Math.max(0, Math.floor(view.scrollTop / ROW_PX) - SPARE);
  const last = Math.min(shown.length, first + Math.ceil(view.clientHeight / ROW_PX) + 2 * SPARE);
  by("window").style.top = `${first * ROW_PX}px`;
  if (!shown.length) { by("window").replaceChildren(element("div", { class: "empty" }, "No board is like that.")); return; }
  by("window").replaceChildren(...shown.slice(first, last).map((at) => {
    const trust = text(boards.trust, at), drift = boards.drift[at];
    return element("div", { class: at === opened ? "row open" : "row", role: "row", onclick: () => open(at) },
      element("span", { title: boards.id[at] }, boards.id[at], boards.odd[at] ? element("b", { class: "flag", title: "unlike all others of its kind" }, " ◆") : ""),
      element("span", { class: trust }, trust), element("span", {}, text(boards.sensor, at)), element("span", {}, text(boards.rig, at)),
      element("span", {}, text(boards.lot, at)), element("span", {}, text(boards.site, at)),
      element("span", { class: "num" }, boards.version[at]), element("span", { class: "num" }, day(boards.start[at])),
      element("span", { class: drift ? "num flag" : "num", title: drift ? data.parameters[drift[1]] : null }, drift ? `${drift[0] > 0 ? "+" : ""}${drift[0]}` : ""),
      element("span", { class: "num" }, number(boards.value[column][at])));
  }));
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
    element("p", {}, element("span", { class: text(boards.trust, at) }, text(boards.trust, at)), `, version ${boards.version[at]}, measured ${day(boards.start[at])}`),
    element("p", {}, element("a", { href: `${file}.report.html` }, "report"), " · ", element("a", { href: `${file}.yaml` }, "calibration")),
    element("p", { id: "versions" }),
    element("p", { class: "soft", id: "loading" }, "loading its history …"));
  if (matchMedia("(max-width:60rem)").matches) panel.scrollIntoView({ block: "start" });  // it is below the table
  load(boards.shard[at], (found) => { if (opened === at) drawBoard(at, found[boards.id[at]] || { points: [], std: [], shrunk: [] }); }, "loading");
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
  script.addEventListener("error", () => { waiting.delete(shard); const word = by(words); if (word) word.textContent = "Its history is not there: make the page again."; });
  document.head.append(script);
}

function openFromHash() {
  const wanted = decodeURIComponent(location.hash.slice(1));
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
