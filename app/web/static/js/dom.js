// Small helpers around the DOM. Text always goes in as text nodes, never as markup.

const SVG = "http://www.w3.org/2000/svg";

/** Return the element with this id. */
export function byId(id) {
  return document.getElementById(id);
}

/** Make an element: attributes (`on` holds listeners, null and false leave one out), then children or text. */
export function el(tag, attributes = {}, ...children) {
  return fill(document.createElement(tag), attributes, children);
}

/** Make an SVG element in the same way. */
export function svg(tag, attributes = {}, ...children) {
  return fill(document.createElementNS(SVG, tag), attributes, children);
}

function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "on") {
      for (const [event, listener] of Object.entries(value)) node.addEventListener(event, listener);
    } else {
      node.setAttribute(name, value === true ? "" : String(value));
    }
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return node;
}

/** Show an error where it belongs, or clear it with null. */
export function showError(place, error) {
  place.replaceChildren(...(error === null ? [] : [notice("error", error.message)]));
}

/** Return a coloured box with a message. */
export function notice(kind, ...children) {
  return el("p", { class: `notice notice-${kind}` }, ...children);
}

/** Run an action with its button disabled, and its error shown at `place` until another file or value is chosen. */
export async function guarded(button, place, action) {
  showError(place, null);
  const hadFocus = document.activeElement === button;
  button.disabled = true;
  button.setAttribute("aria-busy", "true");
  try {
    return await action();
  } catch (error) {
    if (error.name !== "AbortError") {
      showError(place, error);
      button.form?.addEventListener("change", () => showError(place, null), { once: true });
    }
    return undefined;
  } finally {
    button.disabled = false;
    button.removeAttribute("aria-busy");
    // A disabled button loses the focus: the keyboard keeps its place.
    if (hadFocus && document.activeElement === document.body) button.focus({ preventScroll: true });
  }
}

/** Let a button copy a text, and say that it has. */
export function copyButton(button, text) {
  const label = button.textContent;
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(text());
      button.textContent = "Copied";
    } catch {
      // Browsers offer the clipboard to https and localhost only.
      button.textContent = "Select and copy";
    }
    setTimeout(() => {
      button.textContent = label;
    }, 1600);
  });
}
