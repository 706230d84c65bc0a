// Sends a scan in parts (tus 1.0), so that a cut, a restart of the server or a closed page costs one part at most.

import { ApiError, path, request, requestJson, sendBytes } from "./api.js";

const TUS = { "Tus-Resumable": "1.0.0" };
const PART_BYTES = 8_000_000;
const PART_TYPE = "application/offset+octet-stream";
const FIRST_RETRY_MS = 500;
const LAST_RETRY_MS = 5000;
const LOST = "The connection is lost. I try again by myself; what has arrived is kept.";
// No network, and a server that restarts or has too much to do; a full disk doesn't pass.
const isPassing = ({ status }) => status === 0 || status === 429 || (status >= 500 && status !== 507);
// Also a part that is still being written by a connection that broke.
const isPassingForPart = (error) => isPassing(error) || error.status === 409 || error.status === 423;

/**
 * Upload a scan and queue its build; returns what the server answers to that.
 *
 * `onProgress(sent, total, words)` gets words while something is wrong. A file that was begun before, by another page
 * too, goes on where it was.
 */
export async function uploadScan(file, venue, options, onProgress, signal) {
  const remembered = `roomfix.upload.${venue}.${file.name}.${file.size}.${file.lastModified}`;
  if (!file.size) throw new Error("This file is empty. Choose the scan as the app exported it.");
  const patiently = (call) => retried(call, isPassing, signal, () => onProgress(0, 0, LOST));
  for (;;) {
    const upload = localStorage.getItem(remembered) ?? (await patiently(() => begin(file, venue, signal)));
    localStorage.setItem(remembered, upload);
    try {
      await sendAll(upload, file, onProgress, signal);
      const form = new FormData();
      for (const [name, value] of Object.entries({ venue, upload, options: JSON.stringify(options) })) form.set(name, value);
      const headers = { "Idempotency-Key": upload };
      const submitted = await patiently(() => requestJson("database/build", { method: "POST", form, headers, signal }));
      localStorage.removeItem(remembered);
      return submitted;
    } catch (error) {
      // One that waited for too long is gone: it begins anew.
      if (error.status !== 404 || error.message.includes("venue")) throw error;
      localStorage.removeItem(remembered);
    }
  }
}

async function begin(file, venue, signal) {
  const name = btoa(String.fromCharCode(...new TextEncoder().encode(venue)));
  const headers = { ...TUS, "Upload-Length": String(file.size), "Upload-Metadata": `venue ${name}` };
  const response = await request("uploads", { method: "POST", headers, signal });
  return response.headers.get("Location").split("/").at(-1);
}

async function sendAll(upload, file, onProgress, signal) {
  const where = path("uploads", upload);
  let offset = 0;
  const part = async () => {
    const response = await request(where, { method: "HEAD", headers: TUS, signal });
    offset = Number(response.headers.get("Upload-Offset"));
    onProgress(offset, file.size);
    while (offset < file.size) {
      const headers = { ...TUS, "Upload-Offset": String(offset), "Content-Type": PART_TYPE };
      const end = Math.min(offset + PART_BYTES, file.size);
      const begun = offset;
      await sendBytes("PATCH", where, headers, file.slice(begun, end), (sent) => onProgress(begun + sent, file.size), signal);
      offset = end;
    }
  };
  await retried(part, isPassingForPart, signal, () => onProgress(offset, file.size, LOST));
}

/** Call until nothing that passes by itself is in the way. */
async function retried(call, passes, signal, onBreak) {
  let pauseMs = FIRST_RETRY_MS;
  for (;;) {
    try {
      return await call();
    } catch (error) {
      if (!(error instanceof ApiError) || !passes(error)) throw error;
      onBreak();
      await new Promise((resolve) => setTimeout(resolve, pauseMs));
      if (signal.aborted) throw new DOMException("The upload was cancelled.", "AbortError");
      pauseMs = Math.min(LAST_RETRY_MS, 2 * pauseMs);
    }
  }
}
