// What the link to the service carries: how large pictures are asked for, and how many at once.

/** From a fast link to a thin one: share of the width that is asked for, and quality of the JPEG. */
const STEPS = [
  { scale: 1, quality: 85 },
  { scale: 0.5, quality: 70 },
  { scale: 0.25, quality: 60 },
];
/** Smallest width that is asked for, pixels. */
const LEAST_WIDTH = 160;
/** Time on the link beyond which pictures become smaller, and below which they become larger, seconds. A step has up to four times the pixels. */
const SLOW_S = 0.6;
const FAST_S = 0.12;
/** Requests of one picture under way at once on a fast link: while one is on its way back, the next is made. */
const UNDER_WAY = 2;

/** The link that all pictures share. */
export class Link {
  constructor() {
    Object.assign(this, { step: 0, isMeasured: false, underWay: 0, loops: [] });
  }

  /** Whether nothing but one small picture at a time is asked for. */
  get isThin() {
    return this.step > 0;
  }

  /** Whether a picture may be asked for: on a link that is thin or unknown, one of all. */
  admits(loop) {
    const isFast = this.isMeasured && !this.isThin;
    return isFast ? loop.underWay < UNDER_WAY : this.underWay === 0;
  }

  /** The query as large as the link carries it. */
  fit(query) {
    const { scale, quality } = STEPS[this.step];
    const width = Math.min(query.width, Math.max(LEAST_WIDTH, Math.round(query.width * scale)));
    return { ...query, width, quality };
  }

  began(loop) {
    loop.underWay += 1;
    this.underWay += 1;
  }

  /** The other pictures come first, so that each gets its turn. */
  ended(loop) {
    loop.underWay -= 1;
    this.underWay -= 1;
    const at = this.loops.indexOf(loop) + 1;
    for (const next of [...this.loops.slice(at), ...this.loops.slice(0, at)]) next.next();
  }

  /** A picture was on the link for so long. */
  took(seconds) {
    this.isMeasured = true;
    if (seconds > SLOW_S) this.step = Math.min(this.step + 1, STEPS.length - 1);
    else if (seconds < FAST_S) this.step = Math.max(this.step - 1, 0);
  }
}
