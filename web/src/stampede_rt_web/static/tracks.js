// Draws the tracks of the channels, and the time axis above them.

import { clockText, colour } from "./format.js";

const STEPS_SECONDS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60, 120, 300, 600, 1200, 3600, 7200, 14400, 21600];
let colours = {};

export function readColours() {
  colours = Object.fromEntries(
    ["ink", "dim", "line", "span", "tick", "gone", "cut", "hidden", "bad", "accent", "archive"].map((name) => [name, colour(name)]),
  );
}

// Returns the context of a canvas whose pixels match the screen's.
function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}

// `view`: start and length of the visible window in nanoseconds (BigInt, Number), and the chosen instant (BigInt or null).
export function pixelOf(instant, view, width) {
  return (Number(instant - view.start) / view.length) * width;
}

export function drawAxis(canvas, view) {
  const [context, width, height] = fitted(canvas);
  const seconds = view.length / 1e9;
  const step = STEPS_SECONDS.find((one) => (width / seconds) * one >= 90) || 21600;
  const stepNanos = BigInt(Math.round(step * 1e9));
  context.fillStyle = colours.dim;
  context.strokeStyle = colours.line;
  context.font = '11px system-ui, "DejaVu Sans", sans-serif';
  context.beginPath();
  for (let at = (view.start / stepNanos) * stepNanos; at < view.start + BigInt(Math.round(view.length)); at += stepNanos) {
    const x = pixelOf(at, view, width);
    context.moveTo(x, height - 5);
    context.lineTo(x, height);
    const text = clockText(at, step < 1 ? 1 : 0);
    if (x >= 0 && x + 3 + context.measureText(text).width <= width) context.fillText(text, x + 3, height - 8);
  }
  context.stroke();
  if (view.chosen !== null) drawChosen(context, view, width, height);
}

// `track`: the drawing of the server, or undefined; `channel`: its row of the overview; `hiddenFrom`: the group's cut.
export function drawTrack(canvas, track, channel, view, hiddenFrom) {
  const [context, width, height] = fitted(canvas);
  if (track) {
    const shift = Number(BigInt(track.base) - view.start) / 1000;
    const scale = (width * 1000) / view.length;
    const x = (micros) => (micros + shift) * scale;
    const edge = memoryEdge(channel, view, width);
    if (track.items) drawItems(context, track.items, x, edge, height);
    if (track.density) drawDensity(context, track, x, edge, height);
    if (track.ends !== undefined) drawUnread(context, x(track.ends), width, height);
    if (track.archive_oldest) drawArchive(context, pixelOf(BigInt(track.archive_oldest), view, width), edge, width, height);
    drawMarks(context, track.marks, x, height);
    if (Number.isFinite(edge) && edge > 0 && edge < width) drawEdge(context, edge, height);
  }
  if (hiddenFrom !== null) drawHidden(context, pixelOf(hiddenFrom, view, width), width, height);
  if (view.chosen !== null) drawChosen(context, view, width, height);
}

// The pixel of the oldest item in memory. If memory has none, all items are before it.
function memoryEdge(channel, view, width) {
  if (channel?.oldest) return pixelOf(BigInt(channel.oldest), view, width);
  return channel?.held === 0 ? Infinity : -Infinity;
}

function drawItems(context, items, x, edge, height) {
  for (const [begin, end] of items) {
    const left = x(begin);
    const gone = left < edge - 0.5;
    if (end !== null) {
      context.fillStyle = gone ? colours.gone : colours.span;
      context.globalAlpha = 0.55;
      context.fillRect(left, 13, Math.max(1, x(end) - left - 1), height - 26);
      context.globalAlpha = 1;
    }
    context.fillStyle = gone ? colours.gone : colours.tick;
    context.fillRect(left, 8, 1.5, height - 16);
  }
}

function drawDensity(context, track, x, edge, height) {
  const greatest = Math.max(1, ...track.density);
  const pixelMicros = track.lengthMicros / track.density.length;
  const wide = Math.max(1, x(pixelMicros) - x(0) + 0.5);
  track.density.forEach((count, pixel) => {
    if (!count) return;
    const left = x(pixel * pixelMicros);
    const tall = 4 + (height - 14) * (count / greatest);
    context.fillStyle = left < edge - 0.5 ? colours.gone : colours.tick;
    context.fillRect(left, height - 4 - tall, wide, tall);
  });
}

function drawMarks(context, marks, x, height) {
  context.fillStyle = colours.bad;
  for (const mark of marks) {
    const left = x(mark.at);
    context.fillRect(left - 0.5, 2, 2, height - 4);
    context.beginPath();
    context.moveTo(left - 4, 2);
    context.lineTo(left + 5, 2);
    context.lineTo(left + 0.5, 9);
    context.fill();
  }
}

function drawEdge(context, left, height) {
  context.strokeStyle = colours.dim;
  context.setLineDash([3, 3]);
  context.beginPath();
  context.moveTo(left, 0);
  context.lineTo(left, height);
  context.stroke();
  context.setLineDash([]);
}

// A horizontal line below the items that only the archive has. A vertical line shows where the archive begins.
function drawArchive(context, left, edge, width, height) {
  const [from, to] = [Math.max(0, left), Math.min(width, edge)];
  if (to <= from) return;
  context.fillStyle = colours.archive;
  context.fillRect(from, height - 4, to - from, 3);
  if (left >= 0) context.fillRect(left, 4, 2, height - 5);
}

// If a window of the past has very many items, the server reads only the first ones.
function drawUnread(context, left, width, height) {
  context.fillStyle = colours.dim;
  context.font = '11px system-ui, "DejaVu Sans", sans-serif';
  context.fillText("more items: shorten the window", Math.min(left + 6, width - 170), height / 2 + 4);
}

function drawHidden(context, left, width, height) {
  if (left >= width) return;
  const from = Math.max(0, left);
  context.fillStyle = colours.hidden;
  context.fillRect(from, 0, width - from, height);
  context.fillStyle = colours.cut;
  if (left >= 0) context.fillRect(left - 1, 0, 2, height);
}

function drawChosen(context, view, width, height) {
  context.fillStyle = colours.ink;
  context.fillRect(pixelOf(view.chosen, view, width) - 0.5, 0, 1.5, height);
}
