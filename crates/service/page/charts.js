// Figures over the time of a capture, drawn on canvases that share a time axis.

const HEIGHT = 84;
const LEFT = 54;

/** A chart of one column; `scrub` is called with the index of a frame that is pointed at. */
export class Chart {
  constructor(parent, title, unit, colour, scrub) {
    Object.assign(this, { title, unit, colour });
    this.canvas = document.createElement('canvas');
    this.canvas.setAttribute('role', 'img');
    this.canvas.setAttribute('aria-label', `${title} over time`);
    parent.append(this.canvas);
    this.columns = { t: [], values: [], bands: [] };
    this.cursor = 0;
    new ResizeObserver(() => this.paint()).observe(this.canvas);
    const point = (event) => {
      const box = this.canvas.getBoundingClientRect();
      const share = (event.clientX - box.left - LEFT) / Math.max(1, box.width - LEFT);
      scrub(this.nearest(share * this.end));
    };
    this.canvas.addEventListener('pointerdown', (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      point(event);
    });
    this.canvas.addEventListener('pointermove', (event) => event.buttons && point(event));
  }

  get end() {
    return Math.max(1e-3, this.columns.t.at(-1) ?? 1);
  }

  nearest(time) {
    const { t } = this.columns;
    let [low, high] = [0, t.length - 1];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (t[middle] < time) low = middle + 1;
      else high = middle;
    }
    return Math.max(0, low);
  }

  /** Times, values, and coloured spans of time behind them. */
  set(t, values, bands, most) {
    this.columns = { t, values, bands };
    const sorted = [...values].sort((a, b) => a - b);
    // A few wild values would flatten all others.
    this.most = most ?? Math.max(1e-6, 1.15 * (sorted[Math.floor(0.98 * (sorted.length - 1))] ?? 1));
    this.paint();
  }

  setCursor(index) {
    this.cursor = index;
    this.paint();
  }

  paint() {
    const ratio = devicePixelRatio || 1;
    const width = this.canvas.clientWidth;
    if (!width) return;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(HEIGHT * ratio);
    const c = this.canvas.getContext('2d');
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    const style = getComputedStyle(document.documentElement);
    const [text, rim] = [style.getPropertyValue('--faint'), style.getPropertyValue('--rim')];
    const [top, bottom] = [18, HEIGHT - 16];
    const x = (time) => LEFT + (time / this.end) * (width - LEFT);
    for (const { from, to, colour } of this.columns.bands) {
      c.globalAlpha = 0.28;
      c.fillStyle = colour;
      c.fillRect(x(from), top, Math.max(1, x(to) - x(from)), bottom - top);
    }
    c.globalAlpha = 1;
    c.strokeStyle = rim;
    c.strokeRect(LEFT, top, width - LEFT - 1, bottom - top);
    c.fillStyle = text;
    c.font = '12px system-ui, sans-serif';
    c.fillText(`${this.title}`, LEFT, 12);
    c.textAlign = 'right';
    c.fillText(`${label(this.most)} ${this.unit}`, LEFT - 4, top + 9);
    c.fillText('0', LEFT - 4, bottom);
    c.textAlign = 'left';
    c.fillText('0 s', LEFT, HEIGHT - 3);
    c.textAlign = 'right';
    c.fillText(`${this.end.toFixed(0)} s`, width - 2, HEIGHT - 3);
    c.textAlign = 'left';
    this.curve(c, x, (value) => bottom - Math.min(1, value / this.most) * (bottom - top));
    const time = this.columns.t[this.cursor] ?? 0;
    c.strokeStyle = style.getPropertyValue('--accent');
    c.beginPath();
    c.moveTo(x(time), top);
    c.lineTo(x(time), bottom);
    c.stroke();
  }

  curve(c, x, y) {
    const { t, values } = this.columns;
    // A pixel needs no more than its largest value.
    const columns = new Map();
    for (let i = 0; i < t.length; i++) {
      const px = Math.round(x(t[i]));
      if (!(columns.get(px) >= values[i])) columns.set(px, values[i]);
    }
    c.strokeStyle = this.colour;
    c.lineWidth = 1.4;
    c.beginPath();
    let last = null;
    for (const [px, value] of columns) {
      if (last !== null && px - last < 12) c.lineTo(px, y(value));
      else c.moveTo(px, y(value));
      last = px;
    }
    c.stroke();
    c.lineWidth = 1;
  }
}

function label(value) {
  return value >= 100 ? value.toFixed(0) : Number(value.toPrecision(2)).toString();
}
