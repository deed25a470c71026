// Instants are BigInt nanoseconds since the epoch; everything that is shown is text.

export const MILLI = 1_000_000n;

export function clockText(nanos, digits = 3) {
  const date = new Date(Number(nanos / MILLI));
  const fraction = String(((nanos % 1_000_000_000n) + 1_000_000_000n) % 1_000_000_000n).padStart(9, "0");
  const time = [date.getHours(), date.getMinutes(), date.getSeconds()].map((n) => String(n).padStart(2, "0")).join(":");
  return digits ? `${time}.${fraction.slice(0, digits)}` : time;
}

// The time of day, and the date before it unless it is today.
export function instantText(nanos, digits) {
  const date = new Date(Number(nanos / MILLI));
  if (date.toDateString() === new Date().toDateString()) return clockText(nanos, digits);
  const day = [date.getFullYear(), date.getMonth() + 1, date.getDate()].map((n) => String(n).padStart(2, "0")).join("-");
  return `${day} ${clockText(nanos, digits)}`;
}

export function durationText(nanos) {
  if (nanos === null || nanos === undefined) return "–";
  const sign = nanos < 0 ? "−" : "";
  let rest = Math.abs(Number(nanos));
  for (const [unit, size] of [["ns", 1000], ["µs", 1000], ["ms", 1000]]) {
    if (rest < size) return `${sign}${trim(rest)} ${unit}`;
    rest /= size;
  }
  if (rest < 120) return `${sign}${trim(rest)} s`;
  if (rest < 7200) return `${sign}${trim(rest / 60)} min`;
  return rest < 172_800 ? `${sign}${trim(rest / 3600)} h` : `${sign}${trim(rest / 86_400)} days`;
}

export function bytesText(count) {
  if (count === null || count === undefined) return "–";
  for (const unit of ["B", "KiB", "MiB", "GiB"]) {
    if (count < 1024) return `${trim(count)} ${unit}`;
    count /= 1024;
  }
  return `${trim(count)} TiB`;
}

export function rateText(rate) {
  return rate === null || rate === undefined ? "–" : `${trim(rate)}/s`;
}

function trim(number) {
  return number >= 100 || Number.isInteger(number) ? String(Math.round(number)) : number.toFixed(number >= 10 ? 1 : 2);
}

// Control characters, the marks that turn the direction of a text, and other invisible characters become escapes such
// as \u{202e}. Otherwise a producer could make a text look like another one. `kept`: the characters that stay.
export function escaped(text, kept = "") {
  return text.replace(/[\p{C}\p{Zl}\p{Zp}]/gu, (one) => (kept.includes(one) ? one : `\\u{${one.codePointAt(0).toString(16)}}`));
}

// Makes an element. Text goes in as escaped text, never as HTML, because names and payloads come from any producer.
// Only a `pre` keeps its lines.
export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "class") made.className = value;
    else if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key === "title" || key === "aria-label") made.setAttribute(key, escaped(value));
    else if (value !== null && value !== undefined) made.setAttribute(key, value);
  }
  const shown = (text) => (name === "pre" ? escaped(text.replaceAll("\r\n", "\n"), "\n\t") : escaped(text));
  made.append(...children.filter((one) => one !== null && one !== undefined).map((one) => (typeof one === "string" ? shown(one) : one)));
  return made;
}

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

export function globPattern(glob) {
  const escaped = glob.replace(/[.+^${}()|[\]\\]/g, "\\$&").replaceAll("*", ".*").replaceAll("?", ".");
  return new RegExp(`^${escaped}$`);
}
