// What speaks for and against the tag of a frame, drawn over it in pixels of its image.

export function polyline(c, points, closed) {
  c.beginPath();
  points.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
  if (closed) c.closePath();
  c.stroke();
}

export function paintEvidence(c, evidence) {
  const dots = (points, colour, radius) => {
    c.fillStyle = colour;
    for (const [x, y] of points) {
      c.beginPath();
      c.arc(x, y, radius, 0, 2 * Math.PI);
      c.fill();
    }
  };
  dots(evidence.on_line, 'rgb(60 200 255 / 40%)', 0.9);
  dots(evidence.off_line, 'rgb(255 60 230 / 65%)', 0.9);
  dots(evidence.hidden, '#969696', 0.9);
  dots(evidence.found, '#28e650', 1.1);
  c.strokeStyle = '#f02832';
  for (const [x, y] of evidence.missing) {
    c.beginPath();
    c.arc(x, y, 1.8, 0, 2 * Math.PI);
    c.stroke();
  }
  c.strokeStyle = '#ffa028';
  polyline(c, evidence.carpet, true);
}
