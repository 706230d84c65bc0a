// Keeps the screen on while the page works; browsers take the lock away whenever the page is hidden.

let lock = null;

/** Keep the screen on while `isWorking()`, now and whenever the page is shown again. */
export function setUpAwake(isWorking) {
  const stay = async () => {
    if (document.hidden) return;
    try {
      if (isWorking()) lock = await navigator.wakeLock?.request("screen");
      else await lock?.release();
    } catch {
      // Refused, as when the battery is low: the screen goes dark as usual.
    }
  };
  document.addEventListener("visibilitychange", stay);
  return stay;
}
