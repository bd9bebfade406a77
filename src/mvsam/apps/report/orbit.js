// Where the 3D view looks from, and the pointers, fingers and keys that move it.
"use strict";

const HALF_VIEW = Math.tan((50 / 2) * (Math.PI / 180)); // 50 degrees from top to bottom
const LEAST_ASPECT = 1.25; // in narrower pictures the view grows in height, not to lose the sides

// Vectors are arrays of three numbers.
const sum = (first, ...others) =>
  first.map((value, axis) => others.reduce((total, other) => total + other[axis], value));
const times = (factor, vector) => vector.map((value) => factor * value);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [0, 1, 2].map((axis) => {
  const next = (axis + 1) % 3, last = (axis + 2) % 3;
  return a[next] * b[last] - a[last] * b[next];
});
const clamped = (value, low, high) => Math.min(Math.max(value, low), high);

// Circles around `target` in the scene's axes: `turn` and `pitch` in radians, `distance` in metres;
// `up` and `front` are unit vectors, at a right angle to each other. `halfView` is half the height
// of what is seen at a distance of 1.
class Orbit {
  constructor({ up, front, target, pitch, distance }) {
    Object.assign(this, { up, front, side: cross(front, up), halfView: HALF_VIEW });
    this.first = { target, pitch, distance, turn: 0 };
    this.reset();
  }

  reset() {
    Object.assign(this, this.first);
  }

  rotate(turn, pitch) {
    this.turn += turn;
    this.pitch = clamped(this.pitch + pitch, -1.55, 1.55);
  }

  zoom(factor) {
    this.distance = clamped(this.distance * factor, 0.02, 1000);
  }

  // To the right and up, in heights of the picture.
  pan(right, above) {
    const height = 2 * this.halfView * this.distance, axes = this.axes();
    const aside = times(right * height, axes.right), upwards = times(above * height, axes.above);
    this.target = sum(this.target, aside, upwards);
  }

  // Those of the picture; `back` comes towards the eye.
  axes() {
    const cos = Math.cos(this.turn), sin = Math.sin(this.turn);
    const level = sum(times(-cos, this.front), times(sin, this.side));
    const back = sum(times(Math.cos(this.pitch), level), times(Math.sin(this.pitch), this.up));
    const right = sum(times(sin, this.front), times(cos, this.side));
    return { right, above: cross(back, right), back };
  }

  // The 4x4 matrix that WebGL wants, column by column; `aspect` is width over height.
  clipFromWorld(aspect) {
    this.halfView = HALF_VIEW * Math.max(1, LEAST_ASPECT / aspect);
    const { right, above, back } = this.axes();
    const eye = sum(this.target, times(this.distance, back));
    const near = this.distance / 100, far = 100 * this.distance + 100;
    const row = (axis, scale, shift = 0) => [...times(scale, axis), shift - scale * dot(axis, eye)];
    const rows = [
      row(right, 1 / (this.halfView * aspect)),
      row(above, 1 / this.halfView),
      row(back, (near + far) / (near - far), (2 * near * far) / (near - far)),
      row(back, -1),
    ];
    return [0, 1, 2, 3].flatMap((column) => rows.map((values) => values[column]));
  }
}

// Left drag or one finger turns; right or shift drag moves; two fingers move and zoom.
function followPointers(canvas, orbit, redraw) {
  const held = new Map(); // pointer -> where it was last
  const spread = () => {
    const [a, b] = [...held.values()];
    return Math.max(Math.hypot(a.x - b.x, a.y - b.y), 1);
  };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus();
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = held.get(event.pointerId);
    if (!last) return;
    const before = held.size === 2 ? spread() : 1;
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const x = (event.clientX - last.x) / canvas.clientHeight;
    const y = (event.clientY - last.y) / canvas.clientHeight;
    if (held.size === 2) {
      orbit.zoom(before / spread());
      orbit.pan(-x / 2, y / 2); // each of the two fingers does half
    } else if (event.shiftKey || event.buttons & 2) {
      orbit.pan(-x, y);
    } else {
      orbit.rotate(-3 * x, 3 * y);
    }
    redraw();
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => held.delete(event.pointerId));
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  const zoom = (event) => {
    if (document.activeElement !== canvas) return; // the page scrolls
    event.preventDefault();
    orbit.zoom(Math.exp(event.deltaY * (event.deltaMode ? 0.04 : 0.0012))); // lines or pixels
    redraw();
  };
  canvas.addEventListener("wheel", zoom, { passive: false });
}

function followKeys(canvas, orbit, redraw) {
  const moves = {
    ArrowLeft: () => orbit.rotate(-0.1, 0),
    ArrowRight: () => orbit.rotate(0.1, 0),
    ArrowUp: () => orbit.rotate(0, 0.1),
    ArrowDown: () => orbit.rotate(0, -0.1),
    "Shift ArrowLeft": () => orbit.pan(-0.05, 0),
    "Shift ArrowRight": () => orbit.pan(0.05, 0),
    "Shift ArrowUp": () => orbit.pan(0, 0.05),
    "Shift ArrowDown": () => orbit.pan(0, -0.05),
    "+": () => orbit.zoom(0.9),
    "-": () => orbit.zoom(1 / 0.9),
  };
  canvas.addEventListener("keydown", (event) => {
    const move = moves[`Shift ${event.key}`] && event.shiftKey ? `Shift ${event.key}` : event.key;
    if (!moves[move] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    moves[move]();
    redraw();
  });
}
