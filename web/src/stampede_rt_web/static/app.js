// The page: the shown things, the requests to the server, and the keys.

import { bytesText, clockText, durationText, element, escaped, globPattern, instantText, rateText } from "./format.js";
import { Card } from "./cards.js";
import { drawAxis, drawTrack, readColours } from "./tracks.js";
import { fillState } from "./panels.js";
import { ask, repeat } from "./requests.js";

const ROWS_MAX = 40;
const SHOWN_FIRST = 6;
const SHOWN_MAX = 24;
const WINDOWS_SECONDS = [2, 10, 30, 120, 600, 3600, 21_600, 86_400];
const BEFORE_ALL = -(2n ** 63n); // an instant before all items
const FUTURE_SHARE = 0.04; // the part of the window after now, in live mode

const byId = (id) => document.getElementById(id);
// `touched`: the user has chosen the shown cards. `aheadNanos`: by how much the server's clock is ahead of the browser's.
const state = {
  overview: null, findings: null, tracks: Object.create(null), rows: new Map(), cards: new Map(), shown: new Set(), touched: false,
  selected: null, seconds: 10, chosen: null, aheadNanos: 0n, troubles: new Map(),
};

// The host's time: the server's clock, as far as the page knows it.
const now = () => BigInt(Math.round(performance.timeOrigin + performance.now())) * 1_000_000n + state.aheadNanos;

function view() {
  const length = state.seconds * 1e9;
  const start = state.frozen ?? now() - BigInt(Math.round(length * (1 - FUTURE_SHARE)));
  return { start, length, chosen: state.chosen };
}

function visibleChannels() {
  const channels = state.overview?.channels ?? [];
  const glob = byId("filter").value.trim();
  const pattern = glob && globPattern(/[*?]/.test(glob) ? glob : `*${glob}*`);
  return channels.filter((one) => !pattern || pattern.test(one.name)).slice(0, ROWS_MAX);
}

function choose(instant) {
  if (instant !== null && state.frozen === undefined) state.frozen = view().start;
  if (instant === null) state.frozen = undefined;
  state.chosen = instant;
  byId("live").setAttribute("aria-pressed", String(instant === null));
  if (instant !== null) {
    const { start, length } = view();
    const margin = BigInt(Math.round(length * 0.05));
    if (instant < start + margin || instant > start + BigInt(Math.round(length)) - margin) state.frozen = instant - BigInt(Math.round(length / 2));
  }
  wakeItems();
  wakeTracks();
}

function showTrouble(kind, error) {
  if (error) state.troubles.set(kind, error.message);
  else state.troubles.delete(kind);
  const [first] = state.troubles.values();
  byId("trouble").hidden = !first;
  byId("trouble").textContent = escaped(first ?? "");
}

// ---- rows ----

function syncRows() {
  const channels = visibleChannels();
  const names = new Set(channels.map((one) => one.name));
  for (const [name, row] of state.rows) {
    if (!names.has(name)) {
      row.element.remove();
      state.rows.delete(name);
    }
  }
  for (const channel of channels) {
    const row = state.rows.get(channel.name) ?? newRow(channel.name);
    fillRow(row, channel);
    byId("rows").append(row.element);
  }
  if (!state.touched) state.shown = new Set(channels.slice(0, SHOWN_FIRST).map((one) => one.name));
  if (!names.has(state.selected)) select(channels[0]?.name ?? null);
  const total = state.overview.channels_total;
  byId("legend").textContent = total
    ? `${channels.length} of ${total} channels. Ticks are items, bars their spans; pale items have left memory. A violet line: the archive has them. Red marks: late, refused or lost items.`
    : "No channel yet. `stampede put cam/left hello` makes one.";
  syncCards();
}

function newRow(name) {
  const title = element("h3", { title: name }, name);
  const facts = element("small");
  const canvas = element("canvas", { "aria-hidden": "true" });
  const row = { title, facts, canvas };
  row.element = element("div", { class: "row", role: "row", onclick: () => select(name), ondblclick: () => toggle(name) },
    element("div", { role: "rowheader" }, title, facts), canvas);
  addScrubbing(canvas);
  canvas.addEventListener("mousemove", (event) => { canvas.title = markAt(name, event.offsetX / canvas.clientWidth); });
  state.rows.set(name, row);
  return row;
}

function markAt(name, part) {
  const track = state.tracks[name];
  if (!track) return "";
  const { start, length } = view();
  const micros = Number(start - BigInt(track.base)) / 1000 + (length / 1000) * part;
  const near = length / 1000 / 150;
  const texts = track.marks.filter((mark) => Math.abs(mark.at - micros) < near).map((mark) => mark.text);
  return [...texts, ...edgesAt(name, start + BigInt(Math.round(length * part)), length / 150)].map((one) => escaped(one)).join("\n");
}

function edgesAt(name, instant, near) {
  const oldest = state.overview.channels.find((one) => one.name === name)?.oldest;
  const archived = state.tracks[name].archive_oldest;
  const isAt = (edge) => edge && Math.abs(Number(BigInt(edge) - instant)) < near;
  return [
    isAt(oldest) && `Memory begins here: ${instantText(BigInt(oldest), 3)}.`,
    isAt(archived) && `The archive begins here: ${instantText(BigInt(archived), 3)}.`,
  ].filter(Boolean);
}

function fillRow(row, channel) {
  const refused = Object.values(channel.rejected ?? {}).reduce((sum, one) => sum + one, 0);
  const failure = !channel.alive ? `host ${channel.host} is lost` : state.tracks[channel.name]?.failure;
  const age = channel.age_nanos === null || channel.age_nanos === undefined ? "empty" : `${durationText(channel.age_nanos)} ago`;
  const texts = [rateText(channel.rate), bytesText(channel.held_bytes), age, archiveText(channel.name), refused ? `${refused} refused` : ""];
  row.facts.textContent = escaped(failure || texts.filter(Boolean).join(" · "));
  row.facts.className = failure || refused ? "bad" : "";
  row.facts.title = escaped(`${channel.policy}; ${channel.held} items; ${channel.subscriptions} subscriptions; host ${channel.host}`);
  row.element.classList.toggle("shown", state.shown.has(channel.name));
}

function archiveText(name) {
  const oldest = state.tracks[name]?.archive_oldest;
  return oldest ? `archive ${durationText(Number(now() - BigInt(oldest)))}` : "";
}

function select(name) {
  state.selected = name;
  for (const [one, row] of state.rows) row.element.classList.toggle("selected", one === name);
}

function toggle(name) {
  state.touched = true;
  if (!state.shown.delete(name) && state.shown.size < SHOWN_MAX) state.shown.add(name);
  syncRows();
  wakeItems();
}

function addScrubbing(canvas) {
  const pick = (event) => {
    const box = canvas.getBoundingClientRect();
    const { start, length } = view();
    choose(start + BigInt(Math.round(((event.clientX - box.left) / box.width) * length)));
  };
  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); pick(event); });
  canvas.addEventListener("pointermove", (event) => { if (event.buttons & 1) pick(event); });
}

// ---- cards ----

function syncCards() {
  const names = [...state.rows.keys()].filter((name) => state.shown.has(name));
  for (const [name, card] of state.cards) {
    if (!names.includes(name)) {
      card.element.remove();
      state.cards.delete(name);
    }
  }
  for (const name of names) {
    if (!state.cards.has(name)) state.cards.set(name, new Card(name, () => toggle(name)));
    const card = state.cards.get(name);
    if (card.element.parentElement !== byId("items")) byId("items").append(card.element);
  }
}

// ---- requests ----

async function readOverview() {
  const overview = await ask("overview");
  state.overview = overview;
  byId("cluster").textContent = `cluster ${overview.cluster_id.slice(-8)}`;
  const groups = byId("group");
  const names = overview.groups.map((one) => one.name);
  if (names.join("\n") !== [...groups.options].slice(1).map((one) => one.value).join("\n")) {
    const kept = groups.value;
    groups.replaceChildren(element("option", { value: "" }, "no group"), ...names.map((name) => element("option", { value: name }, name)));
    groups.value = names.includes(kept) ? kept : "";
  }
  syncRows();
  fillState(byId("state"), overview, state.findings);
}

async function readTracks() {
  const names = [...state.rows.keys()];
  if (!names.length) return;
  const { start, length } = view();
  const sent = performance.now();
  const width = Math.max(64, Math.min(2048, Math.round(byId("axis").clientWidth)));
  const answer = await ask("timeline", { channel: names, from: start, to: start + BigInt(Math.round(length)), width });
  const middle = BigInt(Math.round(performance.timeOrigin + (sent + performance.now()) / 2)) * 1_000_000n;
  state.aheadNanos = BigInt(answer.now) - middle;
  for (const [name, track] of Object.entries(answer.channels)) {
    state.tracks[name] = { marks: [], ...track, base: answer.base, lengthMicros: length / 1000 };
  }
}

async function readItems() {
  const names = [...state.cards.keys()];
  if (!names.length) return;
  const at = state.chosen === null ? "newest" : state.chosen;
  const answer = await ask("at", { channel: names, at, group: byId("group").value });
  for (const one of answer.items) state.cards.get(one.channel)?.fill(one);
}

async function stepItem(direction, from = state.chosen ?? now()) {
  const answer = await ask("step", { channel: state.selected, at: from, direction, group: byId("group").value });
  if (answer.time !== null) choose(BigInt(answer.time));
}

async function readFindings() {
  state.findings = (await ask("doctor")).findings;
}

const report = (kind) => (error) => showTrouble(kind, error);
const wakeOverview = repeat(1000, readOverview, report("overview"));
const wakeTracks = repeat(250, readTracks, report("tracks"));
const wakeItems = repeat(250, readItems, report("items"));
repeat(15_000, readFindings, report("doctor"));

// ---- drawing, 30 times a second at most ----

let drawn = 0;
function paint(time) {
  requestAnimationFrame(paint);
  if (time - drawn < 30) return;
  drawn = time;
  const seen = view();
  drawAxis(byId("axis"), seen);
  const group = state.overview?.groups.find((one) => one.name === byId("group").value);
  const members = new Set(group?.members.map((one) => one.name));
  for (const [name, row] of state.rows) {
    const channel = state.overview?.channels.find((one) => one.name === name);
    const hiddenFrom = members.has(name) ? (group.cut === null ? seen.start : BigInt(group.cut)) : null;
    drawTrack(row.canvas, state.tracks[name], channel, seen, hiddenFrom);
  }
  byId("instant").textContent = state.chosen === null ? clockText(now(), 1) : instantText(state.chosen, 6);
}
requestAnimationFrame(paint);

// ---- controls ----

function setSeconds(seconds) {
  const middle = state.chosen;
  state.seconds = seconds;
  byId("window").value = String(seconds);
  if (middle !== null) state.frozen = middle - BigInt(Math.round((seconds * 1e9) / 2));
  wakeTracks();
}

function zoom(steps) {
  const at = WINDOWS_SECONDS.indexOf(state.seconds) + steps;
  if (at >= 0 && at < WINDOWS_SECONDS.length) setSeconds(WINDOWS_SECONDS[at]);
}

function move(steps) {
  const names = [...state.rows.keys()];
  const at = names.indexOf(state.selected) + steps;
  if (at >= 0 && at < names.length) {
    select(names[at]);
    state.rows.get(names[at]).element.scrollIntoView({ block: "nearest" });
  }
}

const keys = {
  " ": () => choose(state.chosen === null ? now() : null),
  ArrowLeft: (event) => (event.shiftKey ? nudge(-0.1) : stepItem("previous").catch(report("step"))),
  ArrowRight: (event) => (event.shiftKey ? nudge(0.1) : stepItem("next").catch(report("step"))),
  Home: () => stepItem("next", BEFORE_ALL).catch(report("step")),
  ArrowUp: () => move(-1),
  ArrowDown: () => move(1),
  Enter: () => state.selected && toggle(state.selected),
  "+": () => zoom(-1),
  "-": () => zoom(1),
  "?": () => byId("keys").showModal(),
};

function nudge(part) {
  choose((state.chosen ?? now()) + BigInt(Math.round(state.seconds * 1e9 * part)));
}

// A field takes all keys, and a button the keys that press it.
function isForPage(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || byId("keys").open) return false;
  const name = event.target.tagName;
  return name !== "INPUT" && name !== "SELECT" && !(name === "BUTTON" && /^( |Enter)$/.test(event.key));
}

document.addEventListener("keydown", (event) => {
  if (isForPage(event) && Object.hasOwn(keys, event.key)) {
    event.preventDefault();
    keys[event.key](event);
  }
});
byId("live").addEventListener("click", () => choose(state.chosen === null ? now() : null));
byId("window").addEventListener("change", (event) => setSeconds(Number(event.target.value)));
byId("filter").addEventListener("input", () => { if (state.overview) syncRows(); wakeTracks(); });
byId("group").addEventListener("change", () => wakeItems());
byId("help").addEventListener("click", () => byId("keys").showModal());

const THEME = "stampede-theme";
function setTheme(theme) {
  if (theme) document.documentElement.dataset.theme = theme;
  readColours();
  for (const card of state.cards.values()) card.recolour();
}
byId("theme").addEventListener("click", () => {
  const dark = document.documentElement.dataset.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  const theme = dark === "dark" ? "light" : "dark";
  localStorage.setItem(THEME, theme);
  setTheme(theme);
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => setTheme(null));
setTheme(localStorage.getItem(THEME));
addScrubbing(byId("axis"));
