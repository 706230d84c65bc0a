// A value with undo and redo, kept in the browser until it is saved: nothing unsaved is lost.

const MAX_STEPS = 200;

export class History {
  /** `onChange` runs after each change, undo and redo. */
  constructor(onChange) {
    Object.assign(this, { onChange, key: null, past: [], future: [], value: null, saved: null, field: null });
  }

  /** Begin with what the server has; an unsaved draft under this key comes back. Returns whether there was one. */
  begin(key, value) {
    this.key = `roomfix.draft.${key}`;
    this.saved = JSON.stringify(value);
    const draft = localStorage.getItem(this.key);
    const restored = draft !== null && draft !== this.saved;
    Object.assign(this, { past: restored ? [this.saved] : [], future: [], field: null, value: restored ? draft : this.saved });
    this.onChange();
    return restored;
  }

  get() {
    return JSON.parse(this.value);
  }

  /** Make a change: `change` gets a copy of the value and alters it. Changes of one `field` that follow each other, such
   * as the letters of a name, are one step. */
  change(change, field = null) {
    const copy = this.get();
    change(copy);
    const text = JSON.stringify(copy);
    if (text === this.value) return;
    const goesOn = field !== null && field === this.field && this.past.length > 0;
    this.field = field;
    if (!goesOn) this.past.push(this.value);
    this.past.splice(0, this.past.length - MAX_STEPS);
    this.future = [];
    this.set(text);
  }

  undo() {
    this.field = null;
    if (!this.past.length) return;
    this.future.push(this.value);
    this.set(this.past.pop());
  }

  redo() {
    if (!this.future.length) return;
    this.past.push(this.value);
    this.set(this.future.pop());
  }

  /** Say that the server has the value as it is now, which `value` is the server's form of. */
  stored(value) {
    Object.assign(this, { saved: JSON.stringify(value), past: [], future: [], field: null });
    this.set(this.saved);
  }

  /** Return what says which value is being stored, for `storedAt`. */
  mark() {
    const { key, value } = this;
    return { key, value };
  }

  /** Say that the server has what there was at a mark, which `value` is the server's form of; returns false where it was
   * changed since. Where another floor is worked on by now, its draft alone is forgotten. */
  storedAt(mark, value) {
    if (this.key !== mark.key) {
      if (localStorage.getItem(mark.key) !== mark.value) return false;
      localStorage.removeItem(mark.key);
      return true;
    }
    if (this.value !== mark.value) return false;
    this.stored(value);
    return true;
  }

  /** Take the keys for undo and redo. */
  shortcut(event) {
    if (!(event.ctrlKey || event.metaKey)) return;
    const key = event.key.toLowerCase();
    if (key === "z" && !event.shiftKey) this.undo();
    else if (key === "y" || (key === "z" && event.shiftKey)) this.redo();
    else return;
    event.preventDefault();
  }

  get dirty() {
    return this.value !== this.saved;
  }

  set(text) {
    this.value = text;
    if (this.dirty) localStorage.setItem(this.key, text);
    else localStorage.removeItem(this.key);
    this.onChange();
  }
}
