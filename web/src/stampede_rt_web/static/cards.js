// The items of the shown channels at the chosen instant: pictures, wave forms, plots, text and bytes.

import uPlot from "./vendor/uPlot.esm.js";
import { bytesText, colour, durationText, element, escaped, instantText } from "./format.js";

const HISTORY_MAX = 200;
const PLOT_HEIGHT = 130;

// A card is made once for each channel and then filled, so that a picture does not flicker.
export class Card {
  constructor(name, onClose) {
    this.title = element("h3", { title: name }, name);
    this.view = element("div", { class: "view" });
    this.facts = element("dl");
    this.shown = "";
    this.plot = null;
    this.history = [];
    this.element = element(
      "article",
      { class: "card", "aria-label": name },
      element("header", {}, this.title, element("span", { class: "space" }),
        element("button", { type: "button", "aria-label": `Hide ${name}`, onclick: onClose }, "×")),
      this.view,
      this.facts,
    );
  }

  fill(answer) {
    this.element.classList.toggle("none", !answer.item);
    if (!answer.item) {
      this.replace("none", element("p", {}, answer.failure || [answer.reason, answer.detail].filter(Boolean).join(": ")));
      this.facts.replaceChildren();
      return;
    }
    const { item, preview } = answer;
    const key = `${item.time}/${item.seq}`;
    if (this.shown === key) return;
    this.show(item, preview, key);
    this.facts.replaceChildren(...facts(item, answer.others));
  }

  show(item, preview, key) {
    if (preview.kind === "picture") this.showPicture(preview, key);
    else if (preview.kind === "wave") this.showPlot(key, preview.wave.map((_, at) => at), preview.wave.map((one) => one[1]), preview.wave.map((one) => one[0]));
    else if (preview.kind === "plot") this.showPlot(key, preview.values.map((_, at) => at * preview.step), preview.values);
    else if (preview.kind === "json" && Object.keys(preview.numbers).length) this.showNumbers(item, preview, key);
    else this.replace(key, element("pre", { class: preview.kind }, preview.text));
  }

  // Shows the picture when it is loaded. Until then the former picture stays.
  showPicture(preview, key) {
    this.shown = key;
    const picture = new Image();
    picture.alt = `The picture of ${this.title.textContent}`;
    picture.onload = () => this.shown === key && this.replace(key, picture);
    picture.onerror = () => this.shown === key && this.replace(key, element("p", { class: "dim" }, "This payload is no whole picture."));
    picture.src = preview.url;
  }

  showNumbers(item, preview, key) {
    const time = Number(BigInt(item.time) / 1000n) / 1e6;
    this.history = this.history.filter((one) => one.time < time).slice(1 - HISTORY_MAX);
    this.history.push({ time, numbers: preview.numbers });
    const names = Object.keys(preview.numbers);
    const columns = names.map((name) => this.history.map((one) => one.numbers[name] ?? null));
    this.showPlot(key, this.history.map((one) => one.time), ...columns);
    const values = names.map((name) => `${name} ${Number(preview.numbers[name].toPrecision(6))}`).join("   ");
    if (!this.caption) this.caption = element("pre", { class: "numbers" });
    this.caption.textContent = escaped(values);
    this.view.append(this.caption);
  }

  showPlot(key, xs, ...columns) {
    this.shown = key;
    if (!this.plot || this.plot.series.length !== columns.length + 1) {
      this.replace(key);
      this.plot = newPlot(this.view, xs, columns, Boolean(this.history.length));
    }
    this.plot.setData([xs, ...columns]);
  }

  replace(key, ...children) {
    this.plot?.destroy();
    this.plot = null;
    this.shown = key;
    this.view.replaceChildren(...children);
  }

  recolour() {
    this.shown = "";
    this.plot?.destroy();
    this.plot = null;
  }
}

function newPlot(parent, xs, columns, isTime) {
  const colours = ["accent", "cut", "bad", "dim", "ink", "span", "tick", "gone"].map(colour);
  const axis = { stroke: colour("dim"), grid: { stroke: colour("line") }, ticks: { stroke: colour("line") }, font: "10px sans-serif" };
  const options = {
    width: Math.max(160, parent.clientWidth), height: PLOT_HEIGHT, cursor: { show: false }, legend: { show: false },
    scales: { x: { time: isTime, range: xRange } },
    axes: [{ ...axis, size: 24 }, { ...axis, size: 44 }],
    series: [{}, ...columns.map((_, at) => ({ stroke: colours[at % colours.length], width: 1.2, points: { show: columns[at].length < 3 } }))],
  };
  return new uPlot(options, [xs, ...columns], parent);
}

// For a single point uPlot would show years.
function xRange(plot, least, most) {
  return plot.data[0].length > 1 ? [least, most] : [least - 1, least + 1];
}

function facts(item, others) {
  const rows = [
    ["time", instantText(BigInt(item.time), 6)],
    ["span", item.end === null ? "open" : durationText(Number(BigInt(item.end) - BigInt(item.time)))],
    ["seq", String(item.seq)],
    ["payload", `${bytesText(item.bytes)}${item.content_type ? `, ${item.content_type}` : ""}`],
    ...Object.entries(item.attributes),
  ];
  if (others) rows.push(["also", `${others} more items are valid at this instant`]);
  return rows.flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)]);
}
