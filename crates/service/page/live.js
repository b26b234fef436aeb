// The tab Live: what a robot's recorder sees now.

import { ask, askJson, pause } from './api.js';
import { FieldMap, coveredColour } from './field.js';
import { Link } from './link.js';

const POSE = '#e61e3c';
const INVALID = '#e08a00';
const MIRROR = '#707070';
/** Time between two questions, milliseconds. */
const EVERY_MS = 200;
/** Places of the route that are kept. */
const MAX_ROUTE = 5000;
/** Distance between two places from which no line joins them, metres: the pose was found anew. */
const GAP_M = 0.5;
/** From standard deviations to the ellipse of 95 %. */
const SIGMAS = 2.4477;

const at = (id) => document.getElementById(id);
let active = false;
let running = false;
let map = null;
let state = null;
let picture = null;
let route = [];
let placing = false;
let shownStamp = null;
/** The link to the service, which says how large a picture it carries. */
const link = new Link();

async function follow() {
  if (running) return;
  running = true;
  while (active) {
    try {
      state = await askJson('/v1/live', { patient: true });
      await take();
    } catch (error) {
      if (error.code) tell(error.message);
    }
    await pause(EVERY_MS);
  }
  running = false;
}

/** Whether the buttons give orders. */
function allow(connected) {
  for (const id of ['live-mark', 'live-start', 'live-stop', 'live-place']) at(id).disabled = !connected;
}

async function take() {
  at('live-frame').hidden = !state.frame;
  at('live-map-pane').hidden = !state.watched;
  if (!state.watched) {
    allow(false);
    tell('No robot is watched: `realitysim live user@host:` does that.');
    return;
  }
  if (!state.connected) tell(`${state.robot} is away: ${state.why}`);
  else if (state.no_frame) tell(state.no_frame);
  else tell(state.age_s > 2 ? `the last picture is ${state.age_s.toFixed(0)} s old` : '');
  const lines = state.words ?? [];
  if (at('live-words').dataset.text !== lines.join('\n')) {
    at('live-words').dataset.text = lines.join('\n');
    at('live-words').replaceChildren(...lines.map(item));
  }
  allow(state.connected);
  const stamp = state.frame && JSON.stringify([state.frame.tag.sequence, state.frame.tag.header.stamp]);
  if (!stamp || stamp === shownStamp) return;
  const frame = state.frame;
  shownStamp = stamp;
  // A picture that is gone is of a frame that is gone: the next one is drawn. Raw images have no picture.
  const shown = frame.bytes ? await pictureOf(frame) : null;
  if (frame.bytes && !shown) return;
  picture = shown;
  if (!map.field || JSON.stringify(map.field) !== JSON.stringify(frame.field)) map.setField(frame.field);
  remember(frame.tag);
  paint(frame);
  map.show();
}

/** The picture of a frame, found by the number of its tag, as large as the link carries it. */
async function pictureOf({ tag, lens }) {
  const { width, quality } = link.fit({ width: lens.width });
  const query = new URLSearchParams({ sequence: tag.sequence, ...(link.isThin ? { width, quality } : {}) });
  const began = performance.now();
  try {
    const bytes = await (await ask(`/v1/live/frame?${query}`, { accept: 'image/*' })).blob();
    link.took((performance.now() - began) / 1000);
    return await createImageBitmap(bytes);
  } catch {
    return null;
  }
}

function item(words) {
  const element = document.createElement('li');
  element.textContent = words;
  return element;
}

function tell(words) {
  const said = at('live-said');
  if (said.textContent !== words) said.textContent = words;
  said.classList.toggle('warn', Boolean(words));
}

function remember(tag) {
  if (!tag.valid) return;
  route.push([tag.pose.pose.position.x, tag.pose.pose.position.y]);
  if (route.length > MAX_ROUTE) route.shift();
}

function paint(frame) {
  const canvas = at('live-frame');
  const { width, height } = frame.lens;
  const scale = Math.max(1, Math.min(4096 / width, (canvas.clientWidth * (devicePixelRatio || 1)) / width));
  [canvas.width, canvas.height] = [Math.round(width * scale), Math.round(height * scale)];
  canvas.style.aspectRatio = `${width} / ${height}`;
  const c = canvas.getContext('2d');
  if (picture) c.drawImage(picture, 0, 0, canvas.width, canvas.height);
  c.setTransform(scale, 0, 0, scale, 0, 0);
  c.lineWidth = (devicePixelRatio || 1) / scale;
  c.strokeStyle = frame.tag.valid ? '#ff2848' : '#ffaa00';
  for (const line of frame.lines) {
    c.beginPath();
    line.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
    c.stroke();
  }
  canvas.dataset.frame = String(frame.tag.sequence);
  const { tag } = frame;
  const { x, y } = tag.pose.pose.position;
  const verdict = tag.valid ? 'valid' : `invalid: ${tag.reason}`;
  const half = tag.ambiguous ? ', the half of the field is not known' : '';
  at('live-tag').textContent = `frame ${tag.sequence}: ${verdict}${half}; x ${x.toFixed(2)}, y ${y.toFixed(2)} m, yaw ${degrees(tag.yaw)}°; ${tag.lines_fitting} of ${tag.lines_expected} line places fit`;
}

const degrees = (radians) => ((radians * 180) / Math.PI).toFixed(0);

/** Each cell with images of this session: darker the more headings have one. Rows of letters, y up, as `recorder status` shows them. */
function drawCoverage(field) {
  const coverage = state?.status?.coverage;
  if (!coverage || !at('live-coverage').checked) return;
  const c = field.context;
  const { cell_m, rows, sectors } = coverage;
  c.fillStyle = coveredColour();
  coverage.map.forEach((letters, fromTop) => {
    [...letters].forEach((letter, column) => {
      const headings = { '.': 0, '#': sectors, '+': 10 }[letter] ?? Number(letter);
      if (!headings) return;
      c.globalAlpha = 0.2 + (0.5 * headings) / sectors;
      const [px, py] = field.toPixel(column * cell_m - field.half.x, (rows - fromTop) * cell_m - field.half.y);
      c.fillRect(px, py, cell_m * field.scale, cell_m * field.scale);
    });
  });
  c.globalAlpha = 1;
}

function drawMap(field) {
  drawCoverage(field);
  const tag = state?.frame?.tag;
  const c = field.context;
  c.strokeStyle = POSE;
  c.lineWidth = 1.5;
  c.beginPath();
  route.forEach(([x, y], i) => {
    const [px, py] = route[i - 1] ?? [Infinity, Infinity];
    const joins = Math.hypot(x - px, y - py) < GAP_M;
    if (joins) c.lineTo(...field.toPixel(x, y));
    else c.moveTo(...field.toPixel(x, y));
  });
  c.stroke();
  if (!tag) return;
  const { x, y } = tag.pose.pose.position;
  const mirror = tag.mirror_pose.position;
  if (tag.ambiguous) field.camera(mirror.x, mirror.y, degrees(tag.yaw + Math.PI), MIRROR, 6, 26);
  ellipse(field, x, y, tag.pose.covariance);
  field.camera(x, y, degrees(tag.yaw), tag.valid ? POSE : INVALID, 8, 34);
}

function ellipse(field, x, y, covariance) {
  const [xx, xy, yy] = [covariance[0], covariance[1], covariance[7]];
  const [mean, half] = [(xx + yy) / 2, Math.hypot((xx - yy) / 2, xy)];
  const radii = [mean + half, mean - half].map((variance) => SIGMAS * Math.sqrt(Math.max(0, variance)) * field.scale);
  const c = field.context;
  c.beginPath();
  c.ellipse(...field.toPixel(x, y), ...radii, -0.5 * Math.atan2(2 * xy, xx - yy), 0, 2 * Math.PI);
  c.stroke();
}

async function order(words) {
  const answer = at('live-answer');
  try {
    const done = await askJson('/v1/live/order', { order: words });
    answer.textContent = done.marked ? `marked: ${done.marked}` : done.place ? `placed at ${done.place.map((value) => value.toFixed(2)).join(', ')}` : `the recorder is ${done.state}`;
  } catch (error) {
    answer.textContent = error.code ? error.message : 'there was no answer';
  }
}

/** A press on the map places the robot, and dragging turns it. */
function placeOnMap(canvas) {
  let from = null;
  canvas.addEventListener('pointerdown', (event) => {
    if (!placing || !map.field) return;
    canvas.setPointerCapture(event.pointerId);
    from = map.toField(...map.pointer(event));
  });
  canvas.addEventListener('pointerup', (event) => {
    if (!from) return;
    const to = map.toField(...map.pointer(event));
    const yaw = Math.hypot(to[0] - from[0], to[1] - from[1]) > 0.1 ? Math.atan2(to[1] - from[1], to[0] - from[0]) : (state?.frame?.tag.yaw ?? 0);
    order(`place ${from[0].toFixed(3)},${from[1].toFixed(3)},${degrees(yaw)}`);
    from = null;
    setPlacing(false);
  });
}

function setPlacing(on) {
  placing = on;
  at('live-place').setAttribute('aria-pressed', String(on));
  at('live-answer').textContent = on ? 'press on the field where the robot stands, and drag to where it looks' : at('live-answer').textContent;
}

export function start(info) {
  map = new FieldMap(at('live-map'), drawMap);
  if (info.field) map.setField(info.field);
  at('live-mark').addEventListener('click', () => {
    const note = at('live-note').value.trim() || 'marked in the page';
    order(`mark ${note}`);
    at('live-note').value = '';
  });
  at('live-start').addEventListener('click', () => order('start'));
  at('live-stop').addEventListener('click', () => confirm('Stop the session?') && order('stop'));
  at('live-place').addEventListener('click', () => setPlacing(!placing));
  at('live-coverage').addEventListener('change', () => map.show());
  at('live-frame').hidden = true;
  at('live-map-pane').hidden = true;
  allow(false);
  placeOnMap(at('live-map'));
}

export function show() {
  active = true;
  follow();
}

export function hide() {
  active = false;
}
