// The tab Captures: what was recorded, how well it is tagged, and each frame with the lines of its tag.

import { ask, askJson } from './api.js';
import { Chart } from './charts.js';
import { paintEvidence, polyline } from './evidence.js';
import { FieldMap } from './field.js';

const VALID = '#e61e3c';
const AMBIGUOUS = '#a050d0';
const REASONS = ['#e08a00', '#1e5ae6', '#009aa8', '#777777', '#8a5a2b'];
const BAD = '#e08a00';
const GAP = '#8888ff';
/** Width of the projected lines on the screen, pixels: far lines must stay visible beneath. */
const LINE_PX = 1;
/** Length of a piece that is saved, seconds. */
const PIECE_S = 10;

const at = (id) => document.getElementById(id);
let remember = () => {};
let active = false;
let map = null;
let charts = [];
let capture = null;
let shown = { index: 0, picture: null, lines: [], tag: null, evidence: null };
let asked = 0;
let playing = 0;

function colourOf(index) {
  if (capture.valid[index]) return capture.ambiguous[index] ? AMBIGUOUS : VALID;
  return capture.colours[capture.reason[index]];
}

// Sessions

async function loadSessions() {
  const said = at('sessions-said');
  let list;
  try {
    list = await askJson('/v1/captures', { patient: true });
  } catch (error) {
    if (error.code) tell(said, error.message);
    return [];
  }
  const { sessions, set_aside } = list;
  at('sessions').replaceChildren(...sessions.map(sessionItem), ...set_aside.map(asideItem));
  if (!list.shown) tell(said, 'No captures are shown: start the service with `--captures DIR`.');
  else if (!sessions.length) tell(said, 'The folder holds no capture yet: `realitysim replay LOG -o DIR` makes one of a log, `record` records one.');
  else tell(said, '');
  return sessions;
}

function tell(element, words) {
  element.hidden = !words;
  element.textContent = words;
}

function sessionItem(session) {
  const button = document.createElement('button');
  button.dataset.name = session.name;
  const name = document.createElement('span');
  name.textContent = session.name;
  const words = document.createElement('small');
  const share = session.tagged ? `${((100 * session.valid) / session.tagged).toFixed(1)} % of ${session.tagged} tags valid` : 'no tags listed';
  const open = session.recording ? ', being recorded' : session.open ? ', never finished: `realitysim sessions repair`' : '';
  const lost = session.missing ? `, ${session.missing} of its segments are missing or damaged` : '';
  words.textContent = `${length(session.seconds)}, ${share}, ${(session.bytes / 1e6).toFixed(1)} MB${open}${lost}`;
  button.append(name, words);
  button.addEventListener('click', () => openSession(session.name, 0));
  const item = document.createElement('li');
  item.append(button);
  return item;
}

function asideItem({ name, why }) {
  const item = document.createElement('li');
  const words = document.createElement('small');
  words.textContent = `${name}: ${why}`;
  item.append(words);
  return item;
}

function length(seconds) {
  if (seconds === null) return 'no times';
  return seconds < 120 ? `${seconds.toFixed(1)} s` : `${Math.floor(seconds / 60)} min ${Math.round(seconds % 60)} s`;
}

// One session

async function openSession(name, index) {
  stop();
  for (const button of document.querySelectorAll('#sessions button')) button.setAttribute('aria-current', String(button.dataset.name === name));
  at('capture-pane').hidden = false;
  at('capture-name').textContent = name;
  tellSummary('reading the tags …');
  const number = ++asked;
  let read;
  try {
    read = await askJson(`/v1/capture?${new URLSearchParams({ capture: name })}`, { patient: true });
  } catch (error) {
    tellSummary(error.code ? error.message : '');
    at('capture-name').classList.add('warn');
    return;
  }
  if (number !== asked) return;
  at('capture-name').classList.remove('warn');
  capture = read;
  capture.colours = capture.reasons.map((_, reason) => REASONS[(reason - 1 + REASONS.length) % REASONS.length]);
  describe();
  at('scrub').max = String(Math.max(0, capture.t_s.length - 1));
  map.setField(capture.field);
  drawCharts();
  if (capture.t_s.length) await showFrame(Math.min(index, capture.t_s.length - 1));
}

function tellSummary(words) {
  at('capture-summary').textContent = words;
}

function describe() {
  const count = capture.t_s.length;
  const valid = capture.valid.reduce((sum, is) => sum + is, 0);
  if (!count) {
    tellSummary('This capture has no tags: the camera sent nothing, or the recorder did not tag.');
  } else {
    const share = `${((100 * valid) / count).toFixed(1)} % of ${count} tags are valid, in ${length(capture.t_s.at(-1))}`;
    tellSummary([share, `robot ${capture.robot}`, ...capture.lost, capture.left_out ? `${capture.left_out} more frames are not shown` : ''].filter(Boolean).join('; '));
  }
  const counts = new Map();
  capture.reason.forEach((reason, index) => capture.valid[index] || counts.set(reason, (counts.get(reason) ?? 0) + 1));
  const chips = [...counts].sort((a, b) => b[1] - a[1]).map(([reason, number]) => chip(capture.colours[reason], `${capture.reasons[reason] || 'no reason'}: ${number}`));
  const ambiguous = capture.valid.filter((is, index) => is && capture.ambiguous[index]).length;
  if (ambiguous) chips.unshift(chip(AMBIGUOUS, `valid, half of the field unknown: ${ambiguous}`));
  if (valid > ambiguous) chips.unshift(chip(VALID, `valid: ${valid - ambiguous}`));
  at('reasons').replaceChildren(...chips);
  const events = [
    ...capture.bad.map(({ from_s, to_s, valid_share }) => ({ t_s: from_s, what: `bad minute, up to ${to_s} s: ${(100 * valid_share).toFixed(0)} % valid` })),
    ...capture.marks.map(({ t_s, what }) => ({ t_s, what: `mark: ${what}` })),
    ...capture.gaps.map(({ t_s, what }) => ({ t_s, what: `gap: ${what}` })),
  ].sort((a, b) => a.t_s - b.t_s);
  at('events').replaceChildren(...events.map(eventItem));
}

function chip(colour, words) {
  const element = document.createElement('span');
  element.className = 'chip';
  const sign = document.createElement('i');
  sign.style.background = colour;
  element.append(sign, words);
  return element;
}

function eventItem({ t_s, what }) {
  const item = document.createElement('li');
  const button = document.createElement('button');
  button.textContent = `${t_s.toFixed(1)} s`;
  button.addEventListener('click', () => showFrame(charts[0].nearest(t_s)));
  item.append(button, ` ${what}`);
  return item;
}

function drawCharts() {
  at('charts').replaceChildren();
  const bands = spans((index) => !capture.valid[index], (index) => colourOf(index));
  for (const { t_s } of capture.gaps) bands.push({ from: t_s, to: t_s + 0.2, colour: GAP });
  const bad = capture.bad.map(({ from_s, to_s }) => ({ from: from_s, to: to_s, colour: BAD }));
  const scrub = (index) => showFrame(index);
  const add = (title, unit, colour, values, most) => {
    const chart = new Chart(at('charts'), title, unit, colour, scrub);
    chart.set(capture.t_s, values, [...bad, ...bands], most);
    charts.push(chart);
  };
  charts = [];
  add('sigma of the position; coloured: invalid', 'cm', VALID, capture.sigma_m.map((value) => 100 * value));
  add('line places that fit', '%', '#2a9d4a', capture.fitting.map((value) => 100 * value), 100);
  add('line that is seen and explained', '%', '#1e5ae6', capture.explained.map((value) => 100 * value), 100);
  add('distance of fitting lines', 'px', '#b07000', capture.rms_px);
  add('time since the frame before: peaks are frames that were dropped', 'ms', '#8888ff', capture.t_s.map((time, i) => 1000 * (time - (capture.t_s[i - 1] ?? time))));
}

/** Spans of time in which something holds, with a colour each. */
function spans(holds, colour) {
  const found = [];
  const { t_s } = capture;
  for (let i = 0; i < t_s.length; i++) {
    if (!holds(i)) continue;
    const last = found.at(-1);
    const to = t_s[i + 1] ?? t_s[i];
    if (last && last.to >= t_s[i] && last.colour === colour(i)) last.to = to;
    else found.push({ from: t_s[i], to, colour: colour(i) });
  }
  return found;
}

function drawRoute(field) {
  if (!capture) return;
  const c = field.context;
  for (let i = 0; i < capture.x.length; i++) {
    const [px, py] = field.toPixel(capture.x[i], capture.y[i]);
    c.fillStyle = colourOf(i);
    c.fillRect(px - 1.5, py - 1.5, 3, 3);
  }
  const { index } = shown;
  if (capture.x.length) field.camera(capture.x[index], capture.y[index], capture.yaw_deg[index], colourOf(index), 7, 30);
}

// One frame

async function showFrame(index) {
  if (!capture) return;
  shown = { index, picture: shown.picture, lines: [], tag: null, evidence: null };
  at('scrub').value = String(index);
  at('legend').hidden = true;
  const { t_s, valid, reason, reasons, sigma_m } = capture;
  at('scrub-said').textContent = `frame ${index} (0 to ${t_s.length - 1}), ${t_s[index].toFixed(2)} s`;
  at('frame-said').textContent = valid[index] ? `valid, sigma ${(100 * sigma_m[index]).toFixed(1)} cm` : `invalid: ${reasons[reason[index]]}`;
  at('frame-said').classList.toggle('warn', !valid[index]);
  map.show();
  charts.forEach((chart) => chart.setCursor(index));
  remember({ capture: capture.name, frame: index });
  await loadFrame(index);
}

let loading = null;
/** Loads the newest frame that is wanted; those in between are left out. */
async function loadFrame(index) {
  const wanted = loading;
  loading = index;
  if (wanted !== null) return;
  while (loading !== null) {
    const next = loading;
    const frame = await fetchFrame(next);
    if (loading === next) loading = null;
    if (frame && shown.index === next) {
      Object.assign(shown, frame);
      paintFrame();
      offerDownloads();
    }
  }
}

async function fetchFrame(index) {
  const query = new URLSearchParams({ capture: capture.name, frame: index });
  try {
    const [tag, picture] = await Promise.all([
      askJson(`/v1/tag?${query}`, { patient: true }),
      capture.image[index] ? ask(`/v1/frame?${query}`, { accept: 'image/*', patient: true }).then((answer) => answer.blob()) : null,
    ]);
    if (!picture) at('frame-said').textContent += '; its image is not in the capture (thinned or lost)';
    return { tag: tag.tag, lines: tag.lines, blob: picture, picture: picture && (await createImageBitmap(picture)) };
  } catch (error) {
    at('frame-said').textContent = error.code ? error.message : 'the frame cannot be shown';
    return null;
  }
}

function paintFrame() {
  const canvas = at('frame');
  const { width, height } = capture.lens;
  const zoom = Number(at('zoom').value);
  const box = at('frame-box').clientWidth;
  canvas.style.width = `${box * zoom}px`;
  canvas.style.aspectRatio = `${width} / ${height}`;
  const scale = Math.min(4096 / width, (box * zoom * (devicePixelRatio || 1)) / width);
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const c = canvas.getContext('2d');
  c.imageSmoothingEnabled = scale < 3;
  if (shown.picture) c.drawImage(shown.picture, 0, 0, canvas.width, canvas.height);
  c.setTransform(scale, 0, 0, scale, 0, 0);
  c.lineWidth = (LINE_PX * (devicePixelRatio || 1)) / scale;
  if (at('show-lines').checked) {
    c.strokeStyle = capture.valid[shown.index] ? '#ff2848' : '#ffaa00';
    shown.lines.forEach((line) => polyline(c, line));
  }
  if (shown.evidence?.seen) paintEvidence(c, shown.evidence);
  c.setTransform(1, 0, 0, 1, 0, 0);
  canvas.dataset.frame = String(shown.index);
}

async function explain() {
  const { index } = shown;
  const said = at('frame-said');
  said.textContent = 'the frames before this one in its segment are tagged anew …';
  try {
    const evidence = await askJson(`/v1/explain?${new URLSearchParams({ capture: capture.name, frame: index })}`, { patient: true });
    if (shown.index !== index) return;
    shown.evidence = evidence;
    at('legend').hidden = !evidence.seen;
    said.textContent = evidence.seen
      ? `${evidence.fitting} of ${evidence.expected} line places fit; chance would put as many there once in 10^${evidence.digits.toFixed(0)} pictures; ${(100 * evidence.explained_in_view).toFixed(0)} % of the lines in view are explained`
      : `nothing could be seen: ${evidence.reason}`;
    paintFrame();
  } catch (error) {
    if (shown.index === index) said.textContent = error.code ? error.message : 'there was no answer';
  }
}

let urls = [];
function offerDownloads() {
  urls.forEach((url) => URL.revokeObjectURL(url));
  const name = `${capture.name}-${String(shown.index).padStart(6, '0')}`;
  const tag = new Blob([JSON.stringify(shown.tag, null, 1)], { type: 'application/json' });
  urls = [tag, shown.blob].filter(Boolean).map((blob) => URL.createObjectURL(blob));
  Object.assign(at('save-tag'), { href: urls[0], download: `${name}.json` });
  at('save-frame').hidden = !shown.blob;
  if (shown.blob) Object.assign(at('save-frame'), { href: urls[1], download: `${name}.${shown.blob.type === 'image/png' ? 'png' : 'jpg'}` });
}

/** Saves a log of some seconds around the frame, which replays to the same tags. */
async function savePiece(event) {
  const button = event.target;
  const { index } = shown;
  const words = button.textContent;
  button.disabled = true;
  button.textContent = 'the piece is tagged anew …';
  try {
    const query = new URLSearchParams({ capture: capture.name, frame: index, seconds: PIECE_S });
    const answer = await ask(`/v1/piece?${query}`, { accept: 'application/octet-stream', patient: true });
    save(await answer.blob(), `${capture.name}-${String(index).padStart(6, '0')}.mcap`);
  } catch (error) {
    at('frame-said').textContent = error.code ? error.message : 'there was no answer';
  } finally {
    button.disabled = false;
    button.textContent = words;
  }
}

function save(blob, name) {
  const link = document.createElement('a');
  Object.assign(link, { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

/** Copies the command that cuts the minute around the frame out of the capture. */
async function copyCut(event) {
  const time = capture.begins_s + capture.t_s[shown.index];
  const [from, to] = [Math.max(0, time - 30), time + 30].map((seconds) => seconds.toFixed(1));
  const command = `realitysim log cut CAPTURES/${capture.name} --from ${from} --to ${to} -o piece.mcap`;
  try {
    await navigator.clipboard.writeText(command);
    event.target.textContent = 'copied';
  } catch {
    prompt('The command', command);
  }
  setTimeout(() => (event.target.textContent = 'copy a command that cuts this minute out'), 2000);
}

function play() {
  if (playing) return stop();
  at('play').textContent = '❚❚';
  let [from, began] = [shown.index, performance.now()];
  const step = (now) => {
    if (!playing || !active) return stop();
    const time = capture.t_s[from] + (now - began) / 1000;
    const index = charts[0].nearest(time);
    if (index !== shown.index) showFrame(index);
    if (index >= capture.t_s.length - 1) return stop();
    playing = requestAnimationFrame(step);
  };
  playing = requestAnimationFrame(step);
}

function stop() {
  if (playing) cancelAnimationFrame(playing);
  playing = 0;
  at('play').textContent = '▶';
}

export function start(info, keep) {
  remember = keep;
  map = new FieldMap(at('capture-map'), drawRoute);
  if (info.field) map.setField(info.field);
  at('scrub').addEventListener('input', (event) => showFrame(Number(event.target.value)));
  at('play').addEventListener('click', play);
  at('explain').addEventListener('click', explain);
  at('save-piece').addEventListener('click', savePiece);
  at('copy-cut').addEventListener('click', copyCut);
  at('show-lines').addEventListener('change', paintFrame);
  at('zoom').addEventListener('input', paintFrame);
  new ResizeObserver(() => capture && shown.tag && paintFrame()).observe(at('frame-box'));
  addEventListener('keydown', (event) => {
    if (!active || !capture || event.target.tagName === 'INPUT' || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step) {
      event.preventDefault();
      showFrame(Math.min(capture.t_s.length - 1, Math.max(0, shown.index + step)));
    } else if (event.key === 'l') at('show-lines').click();
    else if (event.key === ' ' && event.target.tagName !== 'BUTTON') {
      event.preventDefault();
      play();
    }
  });
}

export async function show(parameters) {
  active = true;
  const sessions = await loadSessions();
  const name = parameters.get('capture') ?? capture?.name ?? sessions[0]?.name;
  if (!name) return;
  if (capture?.name === name && !parameters.has('frame')) return remember({ capture: name, frame: shown.index });
  await openSession(name, Number(parameters.get('frame')) || 0);
}

export function hide() {
  active = false;
  stop();
}
