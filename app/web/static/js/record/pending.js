// Frames that have not been sent yet, kept on the phone's disk so that a closed page loses none.

const DATABASE = "roomfix-recordings";
const STORE = "frames";

/** Open the store; where the browser keeps nothing on disk, frames stay in memory. */
export async function openPending() {
  try {
    return new DiskPending(await database());
  } catch {
    return new MemoryPending();
  }
}

class DiskPending {
  constructor(base) {
    this.base = base;
  }

  put(frame) {
    return this.run("readwrite", (store) => store.put(frame));
  }

  remove(recording, number) {
    return this.run("readwrite", (store) => store.delete([recording, number]));
  }

  clear(recording) {
    return this.run("readwrite", (store) => store.delete(range(recording)));
  }

  count(recording) {
    return this.run("readonly", (store) => store.count(range(recording)));
  }

  /** Return the first frames of a recording, at most `count`. */
  first(recording, count) {
    return this.run("readonly", (store) => store.getAll(range(recording), count));
  }

  run(mode, call) {
    return new Promise((resolve, reject) => {
      const transaction = this.base.transaction(STORE, mode);
      const asked = call(transaction.objectStore(STORE));
      transaction.addEventListener("complete", () => resolve(asked.result));
      transaction.addEventListener("abort", () => reject(transaction.error));
    });
  }
}

class MemoryPending {
  constructor() {
    this.frames = new Map();
  }

  async put(frame) {
    this.frames.set(frame.number, frame);
  }

  async remove(recording, number) {
    this.frames.delete(number);
  }

  async clear() {
    this.frames.clear();
  }

  async count() {
    return this.frames.size;
  }

  async first(recording, count) {
    return [...this.frames.values()].slice(0, count);
  }
}

const range = (recording) => IDBKeyRange.bound([recording, 0], [recording, Infinity]);

function database() {
  return new Promise((resolve, reject) => {
    const asked = indexedDB.open(DATABASE, 1);
    asked.addEventListener("upgradeneeded", () => asked.result.createObjectStore(STORE, { keyPath: ["recording", "number"] }));
    asked.addEventListener("success", () => resolve(asked.result));
    asked.addEventListener("error", () => reject(asked.error));
  });
}
