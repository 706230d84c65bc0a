// Similarities of the plane: plan = scale * R(turn) * world + shift.

/** Return the plan point of a world point [x, y]. */
export function apply({ x, y, turn, scale }, [wx, wy]) {
  const [c, s] = [scale * Math.cos(turn), scale * Math.sin(turn)];
  return [c * wx - s * wy + x, s * wx + c * wy + y];
}

/** Return the world point of a plan point. */
export function invert({ x, y, turn, scale }, [px, py]) {
  const [c, s] = [Math.cos(turn) / scale, Math.sin(turn) / scale];
  return [c * (px - x) + s * (py - y), -s * (px - x) + c * (py - y)];
}

/** Return a similarity turned and scaled about a plan point, which stays where it is. */
export function changedAbout(similarity, point, { turn = similarity.turn, scale = similarity.scale }) {
  const world = invert(similarity, point);
  const [x, y] = apply({ x: 0, y: 0, turn, scale }, world);
  return { x: point[0] - x, y: point[1] - y, turn, scale };
}

/** Return the similarity of a 4x4 plan_from_world. */
export function fromMatrix(matrix) {
  const scale = Math.hypot(matrix[0][0], matrix[1][0]);
  return { x: matrix[0][3], y: matrix[1][3], turn: Math.atan2(matrix[1][0], matrix[0][0]), scale };
}

/** Return the 4x4 of a similarity; heights keep their shift. */
export function toMatrix({ x, y, turn, scale }, z = 0) {
  const [c, s] = [scale * Math.cos(turn), scale * Math.sin(turn)];
  return [[c, -s, 0, x], [s, c, 0, y], [0, 0, scale, z], [0, 0, 0, 1]];
}

/** Fit to pairs `{world, plan}` by least squares; null with fewer than two places. Two points fit without an error. */
export function fit(pairs) {
  if (pairs.length < 2) return null;
  const mean = (name, i) => pairs.reduce((sum, pair) => sum + pair[name][i], 0) / pairs.length;
  const [wx, wy, px, py] = [mean("world", 0), mean("world", 1), mean("plan", 0), mean("plan", 1)];
  let [dot, cross, spread] = [0, 0, 0];
  for (const { world, plan } of pairs) {
    const [a, b, c, d] = [world[0] - wx, world[1] - wy, plan[0] - px, plan[1] - py];
    dot += a * c + b * d;
    cross += a * d - b * c;
    spread += a * a + b * b;
  }
  if (spread < 1e-6) return null;
  const fitted = { x: 0, y: 0, turn: Math.atan2(cross, dot), scale: Math.hypot(dot, cross) / spread };
  const [x, y] = apply(fitted, [wx, wy]);
  return { ...fitted, x: px - x, y: py - y };
}

/** Return by how many metres each pair is off. */
export function residuals(similarity, pairs) {
  return pairs.map(({ world, plan }) => {
    const [x, y] = apply(similarity, world);
    return Math.hypot(x - plan[0], y - plan[1]);
  });
}

/** Return the number of the pair that contradicts the others: without it they fit far better. -1 for none. */
export function outlier(pairs) {
  if (pairs.length < 4) return -1;
  const rms = (some) => {
    const fitted = fit(some);
    return fitted ? Math.sqrt(residuals(fitted, some).reduce((sum, value) => sum + value * value, 0) / some.length) : Infinity;
  };
  const whole = rms(pairs);
  const without = pairs.map((_, i) => rms(pairs.filter((__, j) => j !== i)));
  const best = Math.min(...without);
  return whole > 0.05 && best < whole / 3 ? without.indexOf(best) : -1;
}
