// The tab Walk: a camera on the field, and beside it at once what it would see there.

import { ask, askJson, pause, say } from './api.js';
import { FieldMap, arrowTip } from './field.js';
import { NAMES, START, bounded, fromParameters, rounded, stepped, toParameters, toQuery } from './pose.js';

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
/** Requests of one picture under way at once: while one is on its way back, the next is made. */
const UNDER_WAY = 2;
/** Time between two changes of the words below a picture. */
const CAPTION_MS = 150;
const MASK = { nothing: 0, unsure: 128 };

const at = (id) => document.getElementById(id);
const state = { pose: { ...START }, lens: '', size: 640, mask: false, error: true, compared: false };
let remember = () => {};
let map = null;
let coverage = null;
let active = false;
let images = 0;
let indexShown = null;
const held = new Set();
const loops = {};

/** A picture that follows the pose: the newest answer is shown, and what came too late is dropped. */
class Loop {
  constructor(method, figure) {
    this.method = method;
    this.figure = figure;
    this.canvas = figure.querySelector('canvas');
    this.caption = figure.querySelector('figcaption');
    this.wanted = null;
    this.underWay = 0;
    this.asked = 0;
    this.drawn = 0;
    this.times = [];
    this.sources = [];
  }

  want() {
    this.wanted = { ...toQuery(state.pose), method: this.method, width: state.size, outside: 'warn', quality: 85 };
    if (state.lens) this.wanted.lens = state.lens;
    if (state.mask) this.wanted.mask = 'alpha';
    this.next();
  }

  next() {
    if (!this.wanted || this.underWay >= UNDER_WAY || this.figure.hidden || !active) return;
    const query = this.wanted;
    this.wanted = null;
    const number = ++this.asked;
    this.underWay += 1;
    this.load(query, number).finally(() => {
      this.underWay -= 1;
      this.next();
    });
  }

  async load(query, number) {
    const accept = query.mask ? 'application/octet-stream' : 'image/jpeg';
    try {
      const answer = await ask(`/v1/view?${new URLSearchParams(query)}`, { accept });
      const picture = query.mask ? await masked(answer) : await createImageBitmap(await answer.blob());
      if (number > this.drawn) this.draw(picture, answer.headers, number);
    } catch (error) {
      await this.fail(error, query);
    }
  }

  draw(picture, headers, number) {
    this.drawn = number;
    const { canvas } = this;
    if (canvas.width !== picture.width || canvas.height !== picture.height) {
      canvas.width = picture.width;
      canvas.height = picture.height;
      canvas.style.aspectRatio = `${picture.width} / ${picture.height}`;
    }
    const context = canvas.getContext('2d');
    if (picture instanceof ImageData) context.putImageData(picture, 0, 0);
    else context.drawImage(picture, 0, 0);
    const now = performance.now();
    this.times = [...this.times.filter((time) => now - time < 1000), now];
    this.sources = JSON.parse(headers.get('realitysim-sources') ?? '[]');
    this.said = this.words(headers);
    this.tell();
    canvas.dataset.views = String(number);
    if (this.method === 'exact') sayOfView(headers.get('realitysim-warning'));
    const index = headers.get('realitysim-index');
    if (indexShown !== null && index !== indexShown) loadCoverage();
    indexShown = index;
    map.show();
  }

  /** Shows the newest words a few times a second: text costs more than pictures. */
  tell() {
    this.telling ??= setTimeout(() => {
      this.telling = null;
      this.caption.textContent = this.said;
    }, CAPTION_MS);
  }

  words(headers) {
    const percent = (name) => `${Math.round(100 * Number(headers.get(name)))} %`;
    const made = /view;dur=([0-9.]+)/.exec(headers.get('server-timing') ?? '');
    const words = [{ exact: '', paper: 'the paper: ', nearest: 'nearest image: ' }[this.method] + headers.get('realitysim-made')];
    words.push(`shows ${percent('realitysim-valid-share')}, ${percent('realitysim-sure-share')} of known geometry`);
    const error = headers.get('realitysim-expected-error-px');
    if (state.error && this.method === 'exact') words.push(error ? `expected error ${Number(error).toFixed(1)} px` : 'error unknown');
    if (made) words.push(`made in ${Number(made[1]).toFixed(1)} ms`);
    if (this.times.length > 2) words.push(`${this.rate()} views/s`);
    return words.join(' · ');
  }

  /** Views in the last second. */
  rate() {
    return this.times.length;
  }

  async fail(error, query) {
    this.said = error.code ? error.message : '';
    this.tell();
    if (this.method === 'exact' && error.code && error.code !== 503) sayOfView(error.message);
    const retry = !error.code || error.code === 503;
    if (!retry) return;
    await pause(error.code ? 300 : 1500);
    this.wanted ??= query;
  }
}

/** A view whose fourth channel is the mask: what is unsure is bluish, what no image shows is red. */
async function masked(answer) {
  const [width, height] = ['realitysim-width', 'realitysim-height'].map((name) => Number(answer.headers.get(name)));
  const pixels = new Uint8ClampedArray(await answer.arrayBuffer());
  for (let i = 0; i < pixels.length; i += 4) {
    if (pixels[i + 3] === MASK.nothing) pixels.set([200, 40, 40], i);
    else if (pixels[i + 3] === MASK.unsure) pixels.set([pixels[i] / 2 + 40, pixels[i + 1] / 2 + 40, pixels[i + 2] / 2 + 110], i);
    pixels[i + 3] = 255;
  }
  return new ImageData(pixels, width, height);
}

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
  if (layer?.of !== coverage || layer.canvas.width !== width || layer.canvas.height !== height) {
    layer = { of: coverage, canvas: new OffscreenCanvas(width, height) };
    const context = layer.canvas.getContext('2d');
    context.scale(width / field.width, height / field.height);
    drawCoverage(field, context);
  }
  return layer.canvas;
}

/** Each cell with images: a sector for each heading, darker the more there are. */
function drawCoverage(field, c) {
  const { cell_m, sectors, columns, counts } = coverage;
  const radius = Math.max(2, (cell_m * field.scale) / 2 - 1);
  const most = Math.max(2, ...coverage.cells.map(({ count }) => count));
  for (const { column, row, sector } of coverage.cells) {
    const count = counts[(row * columns + column) * sectors + sector];
    const [px, py] = field.toPixel((column + 0.5) * cell_m - field.half.x, (row + 0.5) * cell_m - field.half.y);
    const turn = (2 * Math.PI) / sectors;
    c.fillStyle = '#102a4c';
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
const SWITCHES = { m: 'show-mask', c: 'show-compared', x: 'show-error' };

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

let applySwitches = () => {};

/** Prepares the tab; `keep` puts parameters into the address line. */
export function start(info, keep) {
  remember = keep;
  images = info.images;
  map = new FieldMap(at('walk-map'), drawMap);
  if (!info.field) return;
  map.setField(info.field);
  for (const name of Object.keys(info.lenses)) at('lens').append(new Option(name, name));
  for (const method of ['exact', 'paper', 'nearest']) loops[method] = new Loop(method, at(`figure-${method}`));
  dragOnMap(at('walk-map'));
  for (const loop of Object.values(loops)) dragOnView(loop.canvas);
  keys();
  applySwitches = switches();
}

export function show(parameters) {
  if (!map.field) {
    sayOfView('No database is served: start with `--db DIR`.');
    return;
  }
  active = true;
  // A small screen over a thin link is served with less.
  const small = matchMedia('(max-width: 800px)').matches;
  state.pose = fromParameters(parameters);
  state.mask = parameters.get('mask') === '1';
  state.compared = parameters.get('compared') === '1';
  state.lens = parameters.get('lens') ?? '';
  state.size = Number(parameters.get('size') ?? (small ? 320 : 640)) || 640;
  at('show-mask').checked = state.mask;
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
