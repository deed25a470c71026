// The state of the cluster: groups, queues, hosts, supernodes, peers, and the findings of `stampede doctor`.

import { bytesText, clockText, durationText, element } from "./format.js";

export function fillState(parent, overview, findings) {
  const panels = [
    panel("Groups", ["group", "cut", "waits for", "since"], overview.groups, groupRow),
    panel("Queues", ["queue", "#held", "#in flight", "#dead", "oldest"], overview.queues, queueRow),
    panel("Hosts", ["host", "state", "#channels", "#load", "memory"], overview.hosts, hostRow),
    panel("Supernodes", ["supernode", "address", "role", "state"], overview.supernodes, supernodeRow),
    panel("Peers", ["peer", "zone", "clock ahead by"], overview.peers, (one) => [one.name, one.zone || "–", durationText(one.clock)]),
    findings && panel("Doctor", ["part", "state", "advice"], findings.filter((one) => one.advice), doctorRow, "Everything is well."),
    overview.notes.length ? panel("Not shown", ["reason"], overview.notes, (note) => [bad(note)]) : null,
  ];
  parent.replaceChildren(...panels.filter(Boolean));
}

function panel(title, heads, rows, cells, none) {
  if (!rows || (!rows.length && !none)) return null;
  const isNumber = heads.map((head) => head.startsWith("#"));
  const kind = (at) => (isNumber[at] ? { class: "number" } : {});
  const head = element("tr", {}, ...heads.map((text, at) => element("th", kind(at), text.replace("#", ""))));
  const body = rows.map((row) => element("tr", {}, ...cells(row).map((cell, at) => element("td", kind(at), cell))));
  const count = rows.length ? ` (${rows.length})` : "";
  const content = rows.length ? element("table", {}, element("thead", {}, head), element("tbody", {}, ...body)) : element("p", { class: "dim" }, none);
  return element("section", { class: none && rows.length ? "panel wide" : "panel" }, element("h2", {}, title + (none ? "" : count)), content);
}

function bad(text) {
  return element("span", { class: "bad" }, text);
}

function groupRow(group) {
  if (group.failure) return [group.name, bad(group.failure), "", ""];
  const waits = group.waiting_on.length ? group.waiting_on.join(", ") : "–";
  const held = BigInt(group.host_time) - BigInt(group.since);
  const since = group.waiting_on.length ? durationText(Number(held)) : "–";
  const short = group.members.filter((one) => one.too_short).map((one) => one.name);
  const cut = group.cut === null ? "shows nothing yet" : clockText(BigInt(group.cut));
  return [group.name, cut, short.length ? bad(`${waits}; the window is too short for ${short.join(", ")}`) : waits, since];
}

function queueRow(queue) {
  if (queue.failure) return [queue.name, bad(queue.failure), "", "", ""];
  const dead = queue.dead_lettered + queue.dropped;
  return [queue.name, String(queue.held), String(queue.leased), dead ? bad(String(dead)) : "0", durationText(queue.age_nanos)];
}

function hostRow(host) {
  const memory = host.bytes_max ? `${bytesText(host.held_bytes)} of ${bytesText(host.bytes_max)}` : "–";
  const load = host.busy_permille === null ? "–" : `${Math.round(host.busy_permille / 10)} %`;
  return [host.name, host.alive ? "lives" : bad("lost"), String(host.channels), load, memory];
}

function supernodeRow(one) {
  return [one.id, one.endpoint, one.leader ? "leader" : "follower", one.healthy ? "healthy" : bad("silent")];
}

function doctorRow(one) {
  return [`${one.part} ${one.address === "-" ? "" : one.address}`, bad(one.state), one.advice];
}
