// Drift charts: what was measured, its EWMA, baseline and limits, on axes with dates and units.
"use strict";

const CHART = { width: 352, height: 132, left: 62, right: 10, top: 8, bottom: 20 };
const DAY_S = 86400, PER_DEVIATION = 100;  // as the histories are written

// A step of 1, 2 or 5 that cuts a span into about so many.
function stepOf(span, about) {
  const raw = span / about, ten = 10 ** Math.floor(Math.log10(raw));
  return ten * ([1, 2, 5].find((one) => one * ten >= raw * 0.999) || 10);
}

function ticksOf(low, high, about) {
  const step = stepOf(high - low, about), found = [];
  for (let at = Math.ceil(low / step); at * step <= high; at++) found.push(at * step);
  return { step, found };
}

function tickText(value, step) {
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  if (decimals > 6) return value === 0 ? "0" : value.toExponential(1);
  return (Math.abs(value) < step / 2 ? 0 : value).toFixed(decimals);
}

// The nights of a chart as [seconds, EWMA, its deviation]; when says where a night is on the axis.
function nightsOf(chart, when = (night) => night * DAY_S) {
  if (!chart) return [];
  const [from, base, , , unit, moved, std] = chart;
  return moved.map((one, at) => one === null ? null :
    [when(data.days[from + at]), (base || 0) + one * unit / PER_DEVIATION, std[at] * unit / PER_DEVIATION]).filter(Boolean);
}

/* One chart as the text of an SVG. All of it is numbers: nothing of a recording's words is in it.
   points: [seconds, value]; nights: [seconds, EWMA, deviation]; base: what the limits are about, null
   where there is no baseline yet; limit: in deviations. */
function driftChart({ points, nights, base, limit }) {
  const edges = nights.flatMap(([, , std]) => [base - limit * std, base + limit * std]);
  const [y0, y1] = padded([...points.map(([, y]) => y), ...nights.map(([, y]) => y), ...edges, ...(base === null ? [] : [base])]);
  const [x0, x1] = span([...points, ...nights].map(([x]) => x), DAY_S / 2);
  const { width, height, left, right, top, bottom } = CHART;
  const x = (seconds) => (left + (width - left - right) * (seconds - x0) / (x1 - x0)).toFixed(1);
  const y = (value) => (top + (height - top - bottom) * (y1 - value) / (y1 - y0)).toFixed(1);
  const parts = [], { step, found } = ticksOf(y0, y1, 3.5);
  for (const value of found) parts.push(`<line class="grid" x1="${left}" x2="${width - right}" y1="${y(value)}" y2="${y(value)}"/>` +
    `<text class="tick" x="${left - 5}" y="${y(value)}" dy="3.5" text-anchor="end">${tickText(value, step)}</text>`);
  if (nights.length) {
    // of a single night the band has no width
    const walk = nights.length > 1 ? nights : [-1, 1].map((side) => [nights[0][0] + side * (x1 - x0) / 60, ...nights[0].slice(1)]);
    const corners = [...walk.map(([at, , std]) => [at, base + limit * std]), ...[...walk].reverse().map(([at, , std]) => [at, base - limit * std])];
    parts.push(`<polygon class="band" points="${corners.map(([at, one]) => `${x(at)},${y(one)}`).join(" ")}"/>`);
  }
  if (base !== null) parts.push(`<line class="base" x1="${left}" x2="${width - right}" y1="${y(base)}" y2="${y(base)}"/>`);
  for (const [at, one] of points) parts.push(`<circle class="dot" cx="${x(at)}" cy="${y(one)}" r="2"><title>${day(at)}: ${number(one)}</title></circle>`);
  if (nights.length) {
    parts.push(`<polyline class="line" points="${nights.map(([at, one]) => `${x(at)},${y(one)}`).join(" ")}"/>`);
    const [at, one, std] = nights[nights.length - 1], out = Math.abs(one - base) > limit * std;
    parts.push(`<circle class="${out ? "end out" : "end"}" cx="${x(at)}" cy="${y(one)}" r="3.2"/>`);
  }
  parts.push(`<line class="axis" x1="${left}" x2="${width - right}" y1="${height - bottom}" y2="${height - bottom}"/>`);
  const dates = x1 - x0 < 2 * DAY_S ? [[0, "start"]] : [[0, "start"], [0.5, "middle"], [1, "end"]];
  for (const [share, anchor] of dates) {
    const at = x0 + share * (x1 - x0);
    parts.push(`<text class="tick" x="${x(at)}" y="${height - 6}" text-anchor="${anchor}">${day(at)}</text>`);
  }
  return `<svg class="chart" viewBox="0 0 ${width} ${height}" role="img" aria-label="drift chart, ${points.length || nights.length} points">${parts.join("")}</svg>`;
}

function span(values, alone) {
  const low = Math.min(...values), high = Math.max(...values);
  return high > low ? [low, high] : [low - alone, high + alone];
}

function padded(values) {
  const [low, high] = span(values, Math.abs(values[0]) * 0.01 || 1), more = 0.05 * (high - low);
  return [low - more, high + more];
}

// How far the newest night is off, in the unit and in deviations.
function movedText(nights, base, unit) {
  if (!nights.length) return "";
  const [, one, std] = nights[nights.length - 1], off = one - base, sign = off > 0 ? "+" : "";
  return `moved ${sign}${number(off, 3)}${unit}, ${sign}${(off / std).toFixed(1)} sd`;
}

function legend(withPoints) {
  const one = (name, words) => element("span", { class: `key ${name}` }, words);
  return element("p", { class: "legend soft" }, ...(withPoints ? [one("dots", "a calibration, temperature taken off")] : []),
    one("ewma", "EWMA"), one("baseline", withPoints ? "mean of its first nights" : "each board's first nights"), one("limits", "within these limits nothing is told"));
}

// points of a board: [version, seconds, temperature, parameters ...]; std and shrunk: one a parameter, of the newest
function drawBoard(at, { points, std, shrunk, chart }) {
  const panel = by("board"), loading = by("loading"), worst = boards.drift[at] ? boards.drift[at][1] : -1;  // drawn first
  if (!loading) return;  // opened twice while it was on its way
  loading.replaceWith(chart ? legend(true) : element("p", { class: "soft" }, "No drift chart yet: three nights make a baseline."));
  drawVersions(at, points);
  const seconds = new Map(points.map((one) => [Math.floor(one[1] / DAY_S), one[1]]));  // of a night: its newest
  for (const which of [...data.parameters.keys()].sort((a, b) => (b === worst) - (a === worst) || a - b)) {
    const name = data.parameters[which], own = chart ? chart[which] : null;
    const [, base, warm, slope] = own || [0, null, null, null];
    const off = (degrees) => slope === null || warm === null || degrees === null ? 0 : slope * (degrees - warm);
    const dots = points.filter((one) => one[1] !== null && one[3 + which] !== null).map((one) => [one[1], one[3 + which] - off(one[2])]);
    if (!dots.length) continue;
    const nights = nightsOf(own, (night) => seconds.get(night) || night * DAY_S), here = which === worst;
    const drawing = element("div");
    drawing.innerHTML = driftChart({ points: dots, nights, base: nights.length ? base : null, limit: data.limits.board });
    panel.append(element("figure", {},
      caption(here ? "flag" : null, name.replace(/_/g, " ") + (here ? `, drifts ${boards.drift[at][0]} sd` : ""), `${number(boards.value[name][at])} ± ${number(std[which], 2)}${data.units[which]}`),
      drawing, ...notes(at, which, nights, base, shrunk[which])));
  }
}

function caption(kind, left, right) {
  return element("figcaption", {}, element("span", { class: kind }, left), element("span", {}, right));
}

// What to know of a board's chart: how far it is off, what of that is its rig's, what the fleet says.
function notes(at, which, nights, base, shrunk) {
  const name = data.parameters[which], unit = data.units[which], told = [];
  if (nights.length) told.push(caption(null, movedText(nights, base, unit), ""));
  for (const one of data.moves) {
    if (one.parameter !== name || (one.kind !== "fleet" && text(boards[one.kind], at) !== one.group)) continue;
    const who = one.kind === "fleet" ? "the whole fleet's" : `${one.kind} ${one.group}'s`;
    told.push(caption(null, `${who}, not its own: ${one.moved > 0 ? "+" : ""}${number(one.moved, 3)}${unit}`, ""));
  }
  if (shrunk !== null && shrunk !== undefined)
    told.push(caption(null, boards.prior[at] >> which & 1 ? "more the fleet's than its own" : "with the fleet's help", number(shrunk)));
  return told;
}

// The newest versions by name: a server need not list a folder.
function drawVersions(at, points) {
  const folder = data.up + boards.file[at].slice(0, boards.file[at].lastIndexOf("/") + 1);
  const older = points.map((one) => one[0]).filter((version) => version !== boards.version[at]).reverse().slice(0, 6);
  if (!older.length) return;
  by("versions").append("earlier: ", ...older.flatMap((version) => {
    const name = `v${String(version).padStart(4, "0")}`;
    return [element("a", { href: `${folder}${name}.report.html` }, name), " "];
  }));
}
