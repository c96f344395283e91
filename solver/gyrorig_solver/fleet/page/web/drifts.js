// Drift charts: calibrations, their EWMA, baseline and alarm limits, on axes with dates and units.
"use strict";

const CHART = { width: 352, height: 132, left: 62, right: 10, top: 8, bottom: 20 };
const DAY_S = 86400, STEPS_PER_STD = 100;  // as history_scripts.py writes them

// Return a step of 1, 2 or 5 times a power of ten that divides a span into about `about` parts.
function stepOf(span, about) {
  const raw = span / about, ten = 10 ** Math.floor(Math.log10(raw));
  return ten * ([1, 2, 5].find((one) => one * ten >= raw * 0.999) || 10);
}

function ticksOf(low, high, about) {
  const step = stepOf(high - low, about), ticks = [];
  for (let at = Math.ceil(low / step); at * step <= high; at++) ticks.push(at * step);
  if (ticks.length < 2 && high > low) return ticksOf(low, high, 2 * about);  // an axis needs two numbers
  return { step, ticks };
}

function tickText(value, step) {
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  if (decimals > 6) return value === 0 ? "0" : value.toExponential(1);
  return (Math.abs(value) < step / 2 ? 0 : value).toFixed(decimals);
}

// The nights of a chart as [seconds, EWMA, its standard deviation], multiplied by a factor for the unit
// shown; `when` returns the time of a night.
function nightsOf(chart, factor = 1, when = (night) => night * DAY_S) {
  if (!chart) return [];
  const [from, base, , , unit, ewma, std] = chart;
  return ewma.map((steps, at) => steps === null ? null :
    [when(data.days[from + at]), factor * ((base || 0) + steps * unit / STEPS_PER_STD), factor * std[at] * unit / STEPS_PER_STD]).filter(Boolean);
}

/* One chart as the text of an SVG. It contains numbers only, and no text from a recording.
   points: [seconds, value]; nights: [seconds, EWMA, standard deviation]; base: the centre of the limits,
   null before there is a baseline; limit: in standard deviations. */
function driftChart({ points, nights, base, limit }) {
  const edges = nights.flatMap(([, , std]) => [base - limit * std, base + limit * std]);
  const [y0, y1] = padded([...points.map(([, y]) => y), ...nights.map(([, y]) => y), ...edges, ...(base === null ? [] : [base])]);
  const [x0, x1] = span([...points, ...nights].map(([x]) => x), DAY_S / 2);
  const { width, height, left, right, top, bottom } = CHART;
  const x = (seconds) => (left + (width - left - right) * (seconds - x0) / (x1 - x0)).toFixed(1);
  const y = (value) => (top + (height - top - bottom) * (y1 - value) / (y1 - y0)).toFixed(1);
  const parts = [], { step, ticks } = ticksOf(y0, y1, 3.5);
  for (const value of ticks) parts.push(`<line class="grid" x1="${left}" x2="${width - right}" y1="${y(value)}" y2="${y(value)}"/>` +
    `<text class="tick" x="${left - 5}" y="${y(value)}" dy="3.5" text-anchor="end">${tickText(value, step)}</text>`);
  if (nights.length) {
    // a single night gets a band of some width
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

// How far the last night is from the baseline, in the unit and in standard deviations.
function shiftText(nights, base, name) {
  if (!nights.length) return "";
  const [, ewma, std] = nights[nights.length - 1], shift = ewma - base, sign = shift > 0 ? "+" : "";
  return `shift ${sign}${withUnit(number(shift, 3), name)}, ${sign}${(shift / std).toFixed(1)} σ`;
}

function legend(withPoints) {
  const key = (name, words) => element("span", { class: `key ${name}` }, words);
  return element("p", { class: "legend soft" }, ...(withPoints ? [key("dots", "calibration, corrected for temperature")] : []),
    key("ewma", "EWMA"), key("baseline", withPoints ? "mean of the first nights" : "first nights of each board"), key("limits", "no-alarm zone"));
}

// points of a board: [version, seconds, temperature, parameters ...]; std and shrunk: per parameter, of the latest
function drawBoard(at, { points, std, shrunk, chart }) {
  const panel = by("board"), loading = by("loading"), worst = boards.drift[at] ? boards.drift[at][1] : -1;  // drawn first
  if (!loading) return;  // opened twice while the history was loading
  loading.replaceWith(chart ? legend(true) : element("p", { class: "soft" }, "No drift chart yet. The baseline needs three nights before the last, and the scatter eight pairs of nights of the sensor type."));
  drawVersions(at, points);
  const seconds = new Map(points.map((point) => [Math.floor(point[1] / DAY_S), point[1]]));  // the latest of each night
  for (const which of [...data.parameters.keys()].sort((a, b) => (b === worst) - (a === worst) || a - b)) {
    const name = data.parameters[which], series = chart ? chart[which] : null;
    const [, baseline, warm, slope] = series || [0, null, null, null], base = scaled(baseline, name);
    const correction = (degrees) => slope === null || warm === null || degrees === null ? 0 : slope * (degrees - warm);
    const dots = points.filter((point) => point[1] !== null && point[3 + which] !== null).map((point) => [point[1], scaled(point[3 + which] - correction(point[2]), name)]);
    if (!dots.length) continue;
    const nights = nightsOf(series, factorOf(name), (night) => seconds.get(night) || night * DAY_S), isWorst = which === worst;
    const drawing = element("div");
    drawing.innerHTML = driftChart({ points: dots, nights, base: nights.length ? base : null, limit: data.limits.board });
    panel.append(element("figure", {},
      caption(isWorst ? "flag" : null, label(name) + (isWorst ? `, drifting ${boards.drift[at][0]} σ` : ""), withUnit(`${number(scaled(boards.value[name][at], name))} ± ${number(scaled(std[which], name), 2)}`, name)),
      drawing, ...notes(at, which, nights, base, shrunk[which])));
  }
}

function caption(kind, left, right) {
  return element("figcaption", {}, element("span", { class: kind }, left), element("span", {}, right));
}

// Lines below a chart: the shift, shifts of its rig, lot or site, and the shrinkage estimate.
function notes(at, which, nights, base, shrunk) {
  const name = data.parameters[which], lines = [];
  if (nights.length) lines.push(caption(null, shiftText(nights, base, name), ""));
  for (const shift of data.shifts) {
    if (shift.parameter !== name || (shift.kind !== "fleet" && text(boards[shift.kind], at) !== shift.group)) continue;
    const who = shift.kind === "fleet" ? "the whole fleet" : `${shift.kind} ${shift.group}`;
    lines.push(caption(null, `shift of ${who}, not of this board: ${shift.size > 0 ? "+" : ""}${withUnit(number(scaled(shift.size, name), 3), name)}`, ""));
  }
  if (shrunk !== null && shrunk !== undefined)
    lines.push(caption(null, "shrinkage estimate" + (boards.prior[at] >> which & 1 ? ", mostly the fleet's mean" : ""), withUnit(number(scaled(shrunk, name)), name)));
  return lines;
}

// The latest versions by name, because a server may not list folders.
function drawVersions(at, points) {
  const folder = data.up + boards.file[at].slice(0, boards.file[at].lastIndexOf("/") + 1);
  const older = points.map((point) => point[0]).filter((version) => version !== boards.version[at]).reverse().slice(0, 6);
  if (!older.length) return;
  by("versions").append("earlier: ", ...older.flatMap((version) => {
    const name = `v${String(version).padStart(4, "0")}`;
    return [element("a", { href: `${folder}${name}.report.html` }, name), " "];
  }));
}
