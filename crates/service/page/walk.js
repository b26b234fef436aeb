// The tab Walk: a camera on the field, and beside it at once what it would see there.

import { askJson, say } from './api.js';
import { FieldMap, arrowTip, coveredColour } from './field.js';
import { Link } from './link.js';
import { NAMES, START, bounded, fromParameters, rounded, stepped, toParameters } from './pose.js';
import { ViewLoop } from './views.js';

const CAMERA = '#e61e3c';
const SOURCE = '#1e46e6';
const WALK_M_S = 0.7;
const TURN_DEG_S = 50;
const TILT_DEG_S = 25;
const RAISE_M_S = 0.3;
/** Degrees for each pixel that the picture is dragged. */
const DRAG_DEG = 0.2;
/** Pixels around the camera and its tip in which a finger takes hold of them. */
const GRIP_PX = 26;
const at = (id) => document.getElementById(id);
const state = { pose: { ...START }, lens: '', size: 640, mask: false, depth: false, error: true, compared: false };
let remember = () => {};
let map = null;
let coverage = null;
let active = false;
let images = 0;
let indexShown = null;
const held = new Set();
const loops = {};

function sayOfView(words) {
  const said = at('view-said');
  const text = images || !map.field ? (words ?? '') : 'The database has no image yet: add some with `realitysim db add CAPTURE --db DIR`. The page notices.';
  if (said.textContent !== text) said.textContent = text;
  said.classList.toggle('warn', Boolean(text));
}

/** Moves the camera, and asks for its view. */
function move(pose) {
  state.pose = bounded(pose);
  changed();
}

function changed() {
  for (const name of NAMES) {
    const input = at(`pose-${name}`);
    const value = String(rounded(state.pose, name));
    if (input !== document.activeElement && input.value !== value) input.value = value;
  }
  Object.values(loops).forEach((loop) => loop.want());
  map.show();
  keepAddress();
}

let addressTimer = 0;
/** Browsers limit how often the address may change. */
function keepAddress() {
  clearTimeout(addressTimer);
  addressTimer = setTimeout(() => remember(parameters()), 200);
}

function parameters() {
  const kept = toParameters(state.pose);
  if (state.mask) kept.mask = 1;
  if (state.depth) kept.depth = 1;
  if (state.compared) kept.compared = 1;
  if (state.lens) kept.lens = state.lens;
  if (state.size !== 640) kept.size = state.size;
  return kept;
}

function drawMap(field) {
  if (at('show-coverage').checked && coverage) field.context.drawImage(coverageLayer(field), 0, 0, field.width, field.height);
  const sources = at('show-sources').checked ? (loops.exact?.sources ?? []) : [];
  for (const { x, y, yaw_deg, share } of sources) {
    field.context.globalAlpha = 0.35 + 0.65 * Math.min(1, share);
    field.camera(x, y, yaw_deg, SOURCE, 5, 20);
  }
  field.context.globalAlpha = 1;
  field.camera(state.pose.x, state.pose.y, state.pose.yaw, CAMERA, 8, 34);
}

let layer = null;
/** The coverage as a picture, which is drawn anew only when it or the size of the map changes. */
function coverageLayer(field) {
  const { width, height } = field.canvas;
  const colour = coveredColour();
  if (layer?.of !== coverage || layer.colour !== colour || layer.canvas.width !== width || layer.canvas.height !== height) {
    layer = { of: coverage, colour, canvas: new OffscreenCanvas(width, height) };
    const context = layer.canvas.getContext('2d');
    context.scale(width / field.width, height / field.height);
    drawCoverage(field, context, colour);
  }
  return layer.canvas;
}

/** Each cell with images: a sector for each heading, darker the more there are. */
function drawCoverage(field, c, colour) {
  const { cell_m, sectors, columns, counts } = coverage;
  const radius = Math.max(2, (cell_m * field.scale) / 2 - 1);
  const most = Math.max(2, ...coverage.cells.map(({ count }) => count));
  for (const { column, row, sector } of coverage.cells) {
    const count = counts[(row * columns + column) * sectors + sector];
    const [px, py] = field.toPixel((column + 0.5) * cell_m - field.half.x, (row + 0.5) * cell_m - field.half.y);
    const turn = (2 * Math.PI) / sectors;
    c.fillStyle = colour;
    c.globalAlpha = 0.35 + 0.6 * (Math.log(count) / Math.log(most));
    c.beginPath();
    c.moveTo(px, py);
    c.arc(px, py, radius, -sector * turn, -(sector + 1) * turn, true);
    c.fill();
  }
  c.globalAlpha = 1;
}

async function loadCoverage() {
  try {
    const found = await askJson('/v1/coverage?cell_m=0.25&headings=12');
    found.cells = found.counts.flatMap((count, at) => {
      const cell = Math.floor(at / found.sectors);
      return count ? [{ count, sector: at % found.sectors, column: cell % found.columns, row: Math.floor(cell / found.columns) }] : [];
    });
    coverage = found;
    images = found.counts.reduce((sum, count) => sum + count, 0) + found.outside;
    map.show();
  } catch (error) {
    if (error.code) say(error.message);
  }
}

/** The camera is dragged, or its tip to turn it; elsewhere a click puts it there. */
function dragOnMap(canvas) {
  let grip = null;
  const apart = ([ax, ay], [bx, by]) => Math.hypot(ax - bx, ay - by);
  canvas.addEventListener('pointerdown', (event) => {
    if (!map.field) return;
    canvas.setPointerCapture(event.pointerId);
    const point = map.pointer(event);
    const camera = map.toPixel(state.pose.x, state.pose.y);
    const tip = arrowTip(...camera, state.pose.yaw);
    grip = apart(point, tip) < GRIP_PX && apart(point, tip) < apart(point, camera) ? 'turn' : 'move';
    dragged(event);
  });
  const dragged = (event) => {
    if (!grip) return;
    const [x, y] = map.toField(...map.pointer(event));
    if (grip === 'move') move({ ...state.pose, x, y });
    else move({ ...state.pose, yaw: (Math.atan2(y - state.pose.y, x - state.pose.x) * 180) / Math.PI });
  };
  canvas.addEventListener('pointermove', dragged);
  for (const end of ['pointerup', 'pointercancel']) canvas.addEventListener(end, () => (grip = null));
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    move({ ...state.pose, yaw: state.pose.yaw - Math.sign(event.deltaY) * 3 });
  }, { passive: false });
}

/** The picture is dragged to look around; the wheel walks. */
function dragOnView(canvas) {
  let last = null;
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    last = [event.clientX, event.clientY];
  });
  canvas.addEventListener('pointermove', (event) => {
    if (!last) return;
    const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
    last = [event.clientX, event.clientY];
    move({ ...state.pose, yaw: state.pose.yaw + DRAG_DEG * dx, pitch: state.pose.pitch - DRAG_DEG * dy });
  });
  for (const end of ['pointerup', 'pointercancel']) canvas.addEventListener(end, () => (last = null));
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    move(stepped(state.pose, -Math.sign(event.deltaY) * 0.08, 0));
  }, { passive: false });
}

const HELD = {
  w: [1, 0, 0, 0, 0], arrowup: [1, 0, 0, 0, 0], s: [-1, 0, 0, 0, 0], arrowdown: [-1, 0, 0, 0, 0],
  a: [0, 1, 0, 0, 0], d: [0, -1, 0, 0, 0],
  q: [0, 0, 1, 0, 0], arrowleft: [0, 0, 1, 0, 0], e: [0, 0, -1, 0, 0], arrowright: [0, 0, -1, 0, 0],
  r: [0, 0, 0, -1, 0], pageup: [0, 0, 0, -1, 0], f: [0, 0, 0, 1, 0], pagedown: [0, 0, 0, 1, 0],
  t: [0, 0, 0, 0, 1], g: [0, 0, 0, 0, -1],
};
const SWITCHES = { m: 'show-mask', z: 'show-depth', c: 'show-compared', x: 'show-error' };

function keys() {
  const typing = (event) => /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName) && event.target.type !== 'checkbox';
  addEventListener('keydown', (event) => {
    if (!active || event.ctrlKey || event.metaKey || event.altKey || typing(event)) return;
    const key = event.key.toLowerCase();
    if (key in HELD) {
      event.preventDefault();
      hold(key);
    } else if (key in SWITCHES && !event.repeat) {
      at(SWITCHES[key]).click();
    }
  });
  addEventListener('keyup', (event) => held.delete(event.key.toLowerCase()));
  addEventListener('blur', () => held.clear());
  for (const button of document.querySelectorAll('.pad button')) {
    button.addEventListener('pointerdown', (event) => {
      event.preventDefault();
      button.setPointerCapture(event.pointerId);
      hold(button.dataset.key);
    });
    for (const end of ['pointerup', 'pointercancel', 'lostpointercapture']) button.addEventListener(end, () => held.delete(button.dataset.key));
    // A click without a pointer, as by a screen reader or the space bar, is one step.
    button.addEventListener('click', (event) => event.detail === 0 && walk(HELD[button.dataset.key], 0.2));
  }
}

/** Walks as long as a key is held. */
function hold(key) {
  const isFirst = held.size === 0;
  held.add(key);
  if (!isFirst) return;
  let last = performance.now();
  const step = (now) => {
    if (!held.size || !active) return held.clear();
    const seconds = Math.min(0.1, Math.max(0, (now - last) / 1000));
    last = now;
    const sum = [0, 0, 0, 0, 0];
    for (const name of held) HELD[name].forEach((value, at) => (sum[at] += value));
    walk(sum, seconds);
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

function walk([ahead, left, turn, tilt, raise], seconds) {
  const pose = stepped(state.pose, ahead * WALK_M_S * seconds, left * WALK_M_S * seconds);
  pose.yaw += turn * TURN_DEG_S * seconds;
  pose.pitch += tilt * TILT_DEG_S * seconds;
  pose.z += raise * RAISE_M_S * seconds;
  move(pose);
}

function switches() {
  const follow = (id, name, then) => at(id).addEventListener('change', () => {
    state[name] = at(id).type === 'checkbox' ? at(id).checked : at(id).value;
    then?.();
    changed();
  });
  const compare = () => {
    for (const method of ['paper', 'nearest']) at(`figure-${method}`).hidden = !state.compared;
  };
  follow('show-mask', 'mask');
  follow('show-depth', 'depth');
  follow('show-error', 'error');
  follow('show-compared', 'compared', compare);
  follow('lens', 'lens');
  follow('size', 'size', () => (state.size = Number(state.size)));
  for (const id of ['show-coverage', 'show-sources']) at(id).addEventListener('change', () => map.show());
  for (const name of NAMES) {
    at(`pose-${name}`).addEventListener('change', (event) => event.target.value !== '' && move({ ...state.pose, [name]: event.target.value }));
  }
  at('pose').addEventListener('submit', (event) => event.preventDefault());
  at('copy-link').addEventListener('click', async (event) => {
    remember(parameters());
    try {
      await navigator.clipboard.writeText(location.href);
      event.target.textContent = 'copied';
    } catch {
      event.target.textContent = 'it is in the address line';
    }
    setTimeout(() => (event.target.textContent = 'copy a link'), 2000);
  });
  return compare;
}

/** What the pictures tell the tab. */
const tab = {
  isActive: () => active,
  drawn(method, headers) {
    if (method === 'exact') sayOfView(headers.get('realitysim-warning'));
    const index = headers.get('realitysim-index');
    if (indexShown !== null && index !== indexShown) loadCoverage();
    indexShown = index;
    map.show();
  },
  refused(method, words) {
    if (method === 'exact') sayOfView(words);
  },
};

let applySwitches = () => {};

/** Prepares the tab; `keep` puts parameters into the address line. */
export function start(info, keep) {
  remember = keep;
  images = info.images;
  map = new FieldMap(at('walk-map'), drawMap);
  if (!info.field) return;
  map.setField(info.field);
  for (const name of Object.keys(info.lenses)) at('lens').append(new Option(name, name));
  const link = new Link();
  for (const method of ['exact', 'paper', 'nearest']) loops[method] = new ViewLoop(method, at(`figure-${method}`), state, tab, link);
  dragOnMap(at('walk-map'));
  for (const loop of Object.values(loops)) dragOnView(loop.canvas);
  keys();
  applySwitches = switches();
}

export function show(parameters) {
  at('panel-walk').classList.toggle('nothing-served', !map.field);
  if (!map.field) {
    sayOfView('No database is served: start with `--db DIR`.');
    return;
  }
  active = true;
  // A small screen over a thin link is served with less.
  const small = matchMedia('(max-width: 800px)').matches;
  state.pose = fromParameters(parameters);
  state.mask = parameters.get('mask') === '1';
  state.depth = parameters.get('depth') === '1';
  state.compared = parameters.get('compared') === '1';
  state.lens = parameters.get('lens') ?? '';
  state.size = Number(parameters.get('size') ?? (small ? 320 : 640)) || 640;
  at('show-mask').checked = state.mask;
  at('show-depth').checked = state.depth;
  at('show-compared').checked = state.compared;
  at('lens').value = state.lens;
  at('size').value = String(state.size);
  applySwitches();
  loadCoverage().then(() => sayOfView(images ? at('view-said').textContent : ''));
  changed();
}

export function hide() {
  active = false;
  held.clear();
}
