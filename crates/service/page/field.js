// The field from above on a canvas: x to the right, y up, in metres of `map`.

/** A canvas that shows a field to scale. `draw` is called after the field, with the map itself. */
export class FieldMap {
  constructor(canvas, draw) {
    this.canvas = canvas;
    this.context = canvas.getContext('2d');
    this.draw = draw;
    this.field = null;
    this.pending = false;
    new ResizeObserver(() => this.show()).observe(canvas);
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.show());
  }

  setField(field) {
    this.field = field;
    const { x, y } = this.half;
    this.canvas.style.aspectRatio = `${x} / ${y}`;
    this.show();
  }

  /** Half the extent of the carpet, metres. */
  get half() {
    const { length_m, width_m, border_strip_m } = this.field;
    return { x: length_m / 2 + border_strip_m, y: width_m / 2 + border_strip_m };
  }

  get scale() {
    return Math.min(this.width / (2 * this.half.x), this.height / (2 * this.half.y));
  }

  toPixel(x, y) {
    return [this.width / 2 + x * this.scale, this.height / 2 - y * this.scale];
  }

  toField(px, py) {
    return [(px - this.width / 2) / this.scale, (this.height / 2 - py) / this.scale];
  }

  /** Position of a pointer on the canvas, pixels of the page. */
  pointer(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** Draws everything with the next frame of the screen. */
  show() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.paint();
    });
  }

  paint() {
    const ratio = devicePixelRatio || 1;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    if (!this.field || !this.width || !this.height) return;
    const [width, height] = [Math.round(this.width * ratio), Math.round(this.height * ratio)];
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.paintField();
    this.draw(this);
  }

  paintField() {
    const { context: c, field } = this;
    const style = getComputedStyle(document.documentElement);
    c.fillStyle = style.getPropertyValue('--carpet');
    c.fillRect(0, 0, this.width, this.height);
    c.strokeStyle = style.getPropertyValue('--paint');
    c.lineWidth = Math.max(1, field.line_width_m * this.scale);
    const [l, w] = [field.length_m / 2, field.width_m / 2];
    this.rectangle(-l, -w, l, w);
    this.line(0, -w, 0, w);
    this.arc(0, 0, field.centre_circle_diameter_m / 2, 0, 360);
    const mark = field.mark_size_m / 2;
    const cross = (x, y) => {
      this.line(x - mark, y, x + mark, y);
      this.line(x, y - mark, x, y + mark);
    };
    if (field.centre_mark) cross(0, 0);
    for (const side of [-1, 1]) {
      for (const area of [field.goal_area, field.penalty_area]) {
        if (area) this.rectangle(side * l, -area.width_m / 2, side * (l - area.depth_m), area.width_m / 2);
      }
      if (field.penalty_mark_from_goal_line_m != null) cross(side * (l - field.penalty_mark_from_goal_line_m), 0);
      if (field.corner_arc_radius_m) {
        for (const across of [-1, 1]) {
          const towardsCentre = side < 0 ? (across < 0 ? 0 : 270) : across < 0 ? 90 : 180;
          this.arc(side * l, across * w, field.corner_arc_radius_m, towardsCentre, towardsCentre + 90);
        }
      }
      if (field.goal) {
        c.save();
        c.globalAlpha = 0.5;
        this.rectangle(side * l, -field.goal.width_m / 2, side * (l + field.goal.depth_m), field.goal.width_m / 2);
        c.restore();
      }
    }
  }

  line(x0, y0, x1, y1) {
    const c = this.context;
    c.beginPath();
    c.moveTo(...this.toPixel(x0, y0));
    c.lineTo(...this.toPixel(x1, y1));
    c.stroke();
  }

  rectangle(x0, y0, x1, y1) {
    const [[left, top], [right, bottom]] = [this.toPixel(x0, y0), this.toPixel(x1, y1)];
    this.context.strokeRect(Math.min(left, right), Math.min(top, bottom), Math.abs(right - left), Math.abs(bottom - top));
  }

  /** An arc from one angle to another, degrees from x towards y. */
  arc(x, y, radius, from, to) {
    if (!(radius > 0)) return;
    const c = this.context;
    c.beginPath();
    c.arc(...this.toPixel(x, y), radius * this.scale, (-from * Math.PI) / 180, (-to * Math.PI) / 180, true);
    c.stroke();
  }

  /** A camera: a disc with an arrow along its heading. */
  camera(x, y, yaw, colour, radius = 7, arrow = 34) {
    const c = this.context;
    const [px, py] = this.toPixel(x, y);
    const [tx, ty] = arrowTip(px, py, yaw, arrow);
    c.save();
    c.lineCap = 'round';
    for (const [style, width] of [['#ffffff', 6], [colour, 3]]) {
      c.strokeStyle = style;
      c.lineWidth = width;
      c.beginPath();
      c.moveTo(px, py);
      c.lineTo(tx, ty);
      c.stroke();
    }
    c.fillStyle = colour;
    c.strokeStyle = '#ffffff';
    c.lineWidth = 2;
    c.beginPath();
    c.arc(px, py, radius, 0, 2 * Math.PI);
    c.fill();
    c.stroke();
    c.restore();
  }
}

/** Colour of places that have images, by the colour scheme of the page. */
export function coveredColour() {
  return getComputedStyle(document.documentElement).getPropertyValue('--covered');
}

/** The tip of a camera's arrow, pixels. */
export function arrowTip(px, py, yaw, length = 34) {
  const angle = (yaw * Math.PI) / 180;
  return [px + length * Math.cos(angle), py - length * Math.sin(angle)];
}
