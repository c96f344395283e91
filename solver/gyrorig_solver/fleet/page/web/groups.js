// Rigs, lots and sites: a table of each, and the drift charts of the group that is opened.
"use strict";

const GROUPS_SHOWN = 12;
const KIND_WORDS = { rig: "Rigs", lot: "Lots", site: "Sites" };
let groupColumn = "", groupOrder = { key: "shift", down: true }, openedGroup = "";
const allShown = new Set();  // kinds whose groups are all drawn

const sensorsOf = () => new Set(data.groups.map((one) => one.sensor)).size;
const groupName = (one) => one.name || "(no name)";
const ofParameter = (one) => one.parameters[groupColumn] || {};
const wrongOf = (one) => Object.entries(one.states).reduce((sum, [name, n]) => sum + (["ok", "good"].includes(name) ? 0 : n), 0);
const findGroup = (one) => `${one.kind}:${/\s/.test(one.name) ? `"${one.name}"` : one.name}` + (sensorsOf() > 1 ? ` sensor:${one.sensor}` : "");
const signed = (value, digits) => value === null || value === undefined ? "–" : `${value > 0 ? "+" : ""}${value.toFixed(digits)}`;

// key, heading, cell text, whether it is a number, sort key
const GROUP_COLUMNS = [
  ["name", "name", groupName, false, (one) => one.name],
  ["sensor", "sensor", (one) => one.sensor, false, (one) => one.sensor],
  ["boards", "boards", (one) => one.boards.toLocaleString("en"), true, (one) => one.boards],
  ["states", "states", (one) => statesOf(one), false, wrongOf],
  ["shift", "shift, σ", (one) => signed(one.shift_z[groupColumn], 1), true, (one) => size(one.shift_z[groupColumn])],
  ["z", "from the others, σ", (one) => signed(ofParameter(one).z, 1), true, (one) => size(ofParameter(one).z)],
  ["mean", "mean", (one) => number(scaled(ofParameter(one).mean, groupColumn), 4), true, (one) => ofParameter(one).mean],
  ["spread", "spread", (one) => number(scaled(ofParameter(one).spread, groupColumn), 3), true, (one) => ofParameter(one).spread],
];

const known = (value) => value !== null && value !== undefined;
const size = (value) => known(value) ? Math.abs(value) : null;

function statesOf(one) {
  const parts = Object.entries(one.states).filter(([, n]) => n);
  return element("span", {}, ...parts.flatMap(([name, n], at) => [at ? ", " : "", element("span", { class: name === "ok" ? "good" : name }, `${n.toLocaleString("en")} ${name}`)]));
}

function drawGroups() {
  if (!data.groups || !data.groups.length) return;
  by("groups-section").hidden = false;
  const choice = by("group-column");
  for (const name of data.parameters) choice.append(element("option", { value: name }, label(name)));
  groupColumn = choice.value = mostShifted();
  choice.addEventListener("change", () => { groupColumn = choice.value; drawGroupTables(); });
  drawGroupTables();
}

// The parameter with the largest shift of a group, or without charts the largest difference.
function mostShifted() {
  const most = (scores) => scores.reduce((best, one) => size(one[1]) > best[1] ? [one[0], size(one[1])] : best, ["", 0])[0];
  return most(data.groups.flatMap((one) => Object.entries(one.shift_z))) ||
    most(data.groups.flatMap((one) => Object.entries(one.parameters).map(([name, { z }]) => [name, z]))) || data.parameters[0];
}

function drawGroupTables() {
  const unit = unitOf(groupColumn);
  const columns = GROUP_COLUMNS.filter(([key]) => key !== "sensor" || sensorsOf() > 1);
  by("groups").replaceChildren(...Object.keys(KIND_WORDS).flatMap((kind) => {
    const here = sortedGroups(data.groups.filter((one) => one.kind === kind));
    return here.length ? [groupTable(kind, here, columns, unit)] : [];
  }));
}

function sortedGroups(groups) {
  const key = GROUP_COLUMNS.find(([name]) => name === groupOrder.key)[4], sign = groupOrder.down ? -1 : 1;
  return groups.map((one) => [key(one), one]).sort(([a, left], [b, right]) => {
    if (known(a) !== known(b)) return known(a) ? -1 : 1;  // unknown values last
    const order = typeof a === "string" ? a.localeCompare(b, "en", { numeric: true }) : a - b;
    return sign * order || left.name.localeCompare(right.name, "en", { numeric: true });
  }).map(([, one]) => one);
}

function groupTable(kind, groups, columns, unit) {
  const head = element("tr", {}, ...columns.map(([key, words, , numeric]) => element("th", {
    class: numeric ? "num" : null, scope: "col",
    "aria-sort": groupOrder.key === key ? (groupOrder.down ? "descending" : "ascending") : "none",
  }, element("button", { onclick: () => sortGroups(key, numeric) },
    words + (unit && (key === "mean" || key === "spread") ? `, ${unit}` : "") + (groupOrder.key === key ? (groupOrder.down ? " ↓" : " ↑") : "")))));
  const shown = allShown.has(kind) ? groups : groups.slice(0, GROUPS_SHOWN);
  const body = element("tbody", {}, ...shown.map((one) => groupRow(one, columns)));
  const card = element("div", { class: "card", id: `groups-${kind}` },
    element("table", {}, element("caption", {}, `${KIND_WORDS[kind]} `, element("small", {}, groups.length.toLocaleString("en"))), element("thead", {}, head), body));
  if (shown.length < groups.length)
    card.append(element("button", { class: "link more", onclick: () => { allShown.add(kind); drawGroupTables(); } }, `${(groups.length - shown.length).toLocaleString("en")} more`));
  return card;
}

function sortGroups(key, numeric) {
  groupOrder = { key, down: groupOrder.key === key ? !groupOrder.down : numeric || key === "states" };
  drawGroupTables();
}

function groupRow(one, columns) {
  const id = `${one.kind}:${one.name}`;
  const hasShifted = size(one.shift_z[groupColumn]) > data.limits.group;  // without charts both are null: no shift
  const cells = columns.map(([key, , shownAs, numeric]) => {
    const inside = key === "name" ? element("button", { class: "plain", onclick: () => openGroup(one) }, shownAs(one))
      : key === "boards" ? element("button", { class: "plain", title: "show these boards", onclick: () => search(findGroup(one)) }, shownAs(one)) : shownAs(one);
    return element("td", { class: key === "shift" && hasShifted ? "num flag" : numeric ? "num" : null }, inside);
  });
  return element("tr", { class: id === openedGroup ? "open" : null }, ...cells);
}

function openGroup(one) {
  const id = openedGroup = `${one.kind}:${one.name}`, panel = by("group");
  drawGroupTables();
  panel.hidden = false;
  panel.replaceChildren(
    element("button", { class: "link close", onclick: closeGroup, "aria-label": "close" }, "close"),
    element("h3", {}, one.name.startsWith(one.kind) ? one.name : `${one.kind} ${groupName(one)}`),
    element("p", {}, statesOf(one)),
    element("p", {}, element("button", { class: "link", onclick: () => search(findGroup(one)) }, "show the boards")),
    element("p", { class: "soft", id: "group-loading" }, "loading the history …"));
  if (matchMedia("(max-width:60rem)").matches) panel.scrollIntoView({ block: "start" });
  load(one.shard, (entries) => { if (openedGroup === id) drawGroup(one, (entries[id] || {}).chart); }, "group-loading");
}

function closeGroup() {
  openedGroup = ""; by("group").hidden = true;
  drawGroupTables();
}

// The common shift of its boards, relative to the first nights of each board.
function drawGroup(one, chart) {
  const loading = by("group-loading");
  if (!loading) return;  // opened twice while the history was loading
  loading.replaceWith(chart ? legend(false) : element("p", { class: "soft" }, "No drift chart yet. A board's baseline needs three nights before the last, and the scatter eight pairs of nights of the sensor type."));
  if (!chart) return;
  const drawn = data.parameters.map((name, which) => [name, which, nightsOf(chart[which], data.factors[which])]).filter(([, , nights]) => nights.length);
  const off = (nights) => { const [, ewma, std] = nights[nights.length - 1]; return Math.abs(ewma / std); };
  for (const [name, which, nights] of drawn.sort((a, b) => off(b[2]) - off(a[2]))) {
    const drawing = element("div"), out = off(nights) > data.limits.group;
    drawing.innerHTML = driftChart({ points: [], nights, base: 0, limit: data.limits.group });
    by("group").append(element("figure", {}, caption(out ? "flag" : null, label(name), shiftText(nights, 0, name)), drawing));
  }
}
