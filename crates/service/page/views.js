// The pictures of the tab Walk: each follows the pose of the camera.

import { ask, pause } from './api.js';
import { readArrays } from './arrays.js';
import { toQuery } from './pose.js';

/** Time between two changes of the words below a picture. */
const CAPTION_MS = 150;
const MASK = { nothing: 0, unsure: 128 };

/** A picture that follows the pose: the newest answer is shown, and what came too late is dropped. */
export class ViewLoop {
  constructor(method, figure, state, tab, link) {
    Object.assign(this, { method, figure, state, tab, link });
    link.loops.push(this);
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
    const { state } = this;
    this.wanted = { ...toQuery(state.pose), method: this.method, width: state.size, outside: 'warn' };
    if (state.lens) this.wanted.lens = state.lens;
    if (state.depth) this.wanted.layers = 'image,depth,mask';
    else if (state.mask) this.wanted.mask = 'alpha';
    this.next();
  }

  next() {
    if (!this.wanted || this.figure.hidden || !this.tab.isActive() || !this.link.admits(this)) return;
    const query = this.wanted;
    this.wanted = null;
    const number = ++this.asked;
    this.link.began(this);
    this.load(query, number).finally(() => this.link.ended(this));
  }

  async load(query, number) {
    const accept = query.layers ? 'application/zip' : query.mask ? 'application/octet-stream' : 'image/jpeg';
    const asked = performance.now();
    try {
      const answer = await ask(`/v1/view?${new URLSearchParams(this.link.fit(query))}`, { accept });
      const body = await answer.arrayBuffer();
      this.link.took((performance.now() - asked - madeIn(answer.headers)) / 1000);
      const picture = await pictureOf(query, body, answer.headers, this.state.mask);
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
    this.tab.drawn(this.method, headers);
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
    const made = madeIn(headers);
    const words = [{ exact: '', paper: 'the paper: ', nearest: 'nearest image: ' }[this.method] + headers.get('realitysim-made')];
    words.push(`shows ${percent('realitysim-valid-share')}, ${percent('realitysim-sure-share')} of known geometry`);
    const error = headers.get('realitysim-expected-error-px');
    if (this.state.error && this.method === 'exact') words.push(error ? `expected error ${Number(error).toFixed(1)} px` : 'error unknown');
    if (made) words.push(`made in ${made.toFixed(1)} ms`);
    if (this.link.isThin) words.push('thin link: smaller pictures');
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
    if (error.code && error.code !== 503) this.tab.refused(this.method, error.message);
    const retry = !error.code || error.code === 503;
    if (!retry) return;
    await pause(error.code ? 300 : 1500);
    this.wanted ??= query;
  }
}

/** Time that the service took to make a view, milliseconds; 0 if it does not say. */
function madeIn(headers) {
  return Number(/view;dur=([0-9.]+)/.exec(headers.get('server-timing') ?? '')?.[1] ?? 0);
}

/** What is drawn of an answer's bytes. */
function pictureOf(query, body, headers, showsMask) {
  if (query.layers) return deep(body, showsMask);
  return query.mask ? masked(body, headers) : createImageBitmap(new Blob([body], { type: 'image/jpeg' }));
}

/** A view whose fourth channel is the mask. */
function masked(body, headers) {
  const [width, height] = ['realitysim-width', 'realitysim-height'].map((name) => Number(headers.get(name)));
  const pixels = new Uint8ClampedArray(body);
  for (let i = 0; i < pixels.length; i += 4) {
    markMask(pixels, i, pixels[i + 3]);
    pixels[i + 3] = 255;
  }
  return new ImageData(pixels, width, height);
}

/** Shows the mask at a pixel: what lies beyond the ground is bluish, what no image shows is red. */
function markMask(pixels, i, mask) {
  if (mask === MASK.nothing) pixels.set([200, 40, 40], i);
  else if (mask === MASK.unsure) pixels.set([pixels[i] / 2 + 40, pixels[i + 1] / 2 + 40, pixels[i + 2] / 2 + 110], i);
}

/** A view tinted by its depth, with the mask if that is shown too; depth that is not known stays untinted. */
function deep(body, showsMask) {
  const { image, depth, mask } = readArrays(body);
  const [height, width] = depth.shape;
  const pixels = new Uint8ClampedArray(4 * width * height);
  for (let at = 0, i = 0; at < depth.values.length; at++, i += 4) {
    pixels.set(image.values.subarray(3 * at, 3 * at + 3), i);
    pixels[i + 3] = 255;
    if (showsMask) markMask(pixels, i, mask.values[at]);
    if (Number.isFinite(depth.values[at])) tint(pixels, i, depth.values[at]);
  }
  return new ImageData(pixels, width, height);
}

/** Depth at which the tint is halfway from red (near) to blue (far), metres. */
const MIDDLE_M = 3;
/** Step between two contours of depth, metres. */
const CONTOUR_M = 1;

/** Red is near and blue far; each second metre is darker, so that distances can be counted. */
function tint(pixels, i, metres) {
  const far = metres / (metres + MIDDLE_M);
  const shade = Math.floor(metres / CONTOUR_M) % 2 ? 0.75 : 1;
  const colour = [255 * (1 - far), 160 * (1 - Math.abs(2 * far - 1)), 255 * far];
  for (let channel = 0; channel < 3; channel++) pixels[i + channel] = shade * (0.45 * pixels[i + channel] + 0.55 * colour[channel]);
}
