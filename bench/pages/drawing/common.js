// What both drawings are driven with: a dot that moves ten times a second, and a plan that is pushed in every frame.

export const get = async (path) => (await fetch(path)).json();

const MOVES_A_S = 10;
const PUSH_PX = 4;

/** Call `move(x, y)` along points in metres for some seconds; returns how often, and how many frames were drawn. */
export async function walk(points, move, seconds) {
  const counted = frames();
  let moves = 0;
  await new Promise((resolve) => {
    const timer = setInterval(() => {
      const share = moves / (MOVES_A_S * seconds);
      const along = share * (points.length - 1);
      const i = Math.min(Math.floor(along), points.length - 2);
      const [[ax, ay], [bx, by]] = [points[i], points[i + 1]];
      move(ax + (bx - ax) * (along - i), ay + (by - ay) * (along - i));
      moves += 1;
      if (moves >= MOVES_A_S * seconds) {
        clearInterval(timer);
        resolve();
      }
    }, 1000 / MOVES_A_S);
  });
  return { moves, frames: counted() };
}

/** Call `push(dx, dy)` in every frame for some seconds; returns how many there were. */
export async function pan(push, seconds) {
  const counted = frames();
  const end = performance.now() + 1000 * seconds;
  let n = 0;
  await new Promise((resolve) => {
    const step = () => {
      const side = Math.floor(n / 40) % 2 ? -1 : 1;
      push(side * PUSH_PX, (side * PUSH_PX) / 2);
      n += 1;
      if (performance.now() < end) requestAnimationFrame(step);
      else resolve();
    };
    requestAnimationFrame(step);
  });
  return { frames: counted() };
}

/** Count frames until the returned function is called. */
function frames() {
  let [n, on] = [0, true];
  const count = () => {
    n += 1;
    if (on) requestAnimationFrame(count);
  };
  requestAnimationFrame(count);
  return () => {
    on = false;
    return n;
  };
}

/** Wait until what is on the page is drawn, and say when. */
export const drawn = () =>
  new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(() => resolve(performance.now()))));
