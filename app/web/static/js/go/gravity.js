// The direction of down in the axes of the rear camera's picture, from the device's orientation.

let orientation = null;

/** Begin to listen; asks for permission where the browser wants that, which needs a click. */
export async function watchOrientation() {
  const ask = globalThis.DeviceOrientationEvent?.requestPermission;
  if (ask) await ask.call(DeviceOrientationEvent).catch(() => "denied");
  addEventListener("deviceorientation", ({ beta, gamma }) => {
    orientation = beta === null || gamma === null ? null : { beta, gamma };
  });
}

/** Return down as [x, y, z] with x right, y down, z forward in the picture; null while it is not known. */
export function gravity() {
  return orientation && downInPicture(orientation.beta, orientation.gamma, screen.orientation?.angle ?? 0);
}

/**
 * The device's axes are x right, y up, z out of the screen; its attitude is Rz(alpha) Rx(beta) Ry(gamma), whose third
 * row is the direction of up. Browsers turn the picture with the screen, by `angle` counter-clockwise.
 */
export function downInPicture(beta, gamma, angle) {
  const [b, g, a] = [beta, gamma, angle].map((degrees) => (degrees * Math.PI) / 180);
  const [x, y, z] = [Math.cos(b) * Math.sin(g), -Math.sin(b), -Math.cos(b) * Math.cos(g)];
  const right = Math.cos(a) * x - Math.sin(a) * y;
  const up = Math.sin(a) * x + Math.cos(a) * y;
  return [right, -up, -z];
}
