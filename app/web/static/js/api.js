// All calls to the server. Addresses are relative to this file's, so that pages also work below a path prefix.

import { eventData } from "./sse.js";

const KEY = "roomfix.key";
const ROOT = new URL("../../", import.meta.url);
let askForKey = async () => null;

/** An error answer: its sentence as the message, the stable code beside it. */
export class ApiError extends Error {
  constructor(status, code, detail) {
    super(detail);
    this.name = "ApiError";
    this.status = status;
    this.code = code;
  }
}

/** Set what asks the user for a key; it gets the server's reason and returns the key, or null. */
export function onKeyNeeded(ask) {
  askForKey = ask;
}

export const storedKey = {
  get: () => sessionStorage.getItem(KEY),
  set: (key) => sessionStorage.setItem(KEY, key),
  forget: () => sessionStorage.removeItem(KEY),
};

/** Return a path's absolute address. */
export function address(path) {
  return new URL(path, ROOT).href;
}

/** Join parts to a path, each escaped. */
export function path(...parts) {
  return parts.map((part) => encodeURIComponent(part)).join("/");
}

/** Call the server and return the response; throws `ApiError`, after asking for a key where one is needed. */
export async function request(where, { method = "GET", json, form, headers: more = {}, signal } = {}) {
  for (;;) {
    const headers = { ...authorization(), ...more };
    if (json !== undefined) headers["Content-Type"] = "application/json";
    const body = json === undefined ? form : JSON.stringify(json);
    const response = await reach(() => fetch(address(where), { method, headers, body, signal }));
    if (response.ok) return response;
    const error = problem(response.status, await response.text());
    if (!(await keyEntered(error))) throw error;
  }
}

/** Call the server and return the JSON of its answer. */
export async function requestJson(where, options) {
  return (await request(where, options)).json();
}

/** Send bytes and report how many of them have gone, which fetch can't. */
export async function sendBytes(method, where, headers, body, onProgress, signal) {
  for (;;) {
    const { status, text } = await send(method, where, headers, body, onProgress, signal);
    if (status >= 200 && status < 300) return;
    const error = problem(status, text);
    if (!(await keyEntered(error))) throw error;
  }
}

/** Yield the state of a build whenever it changes, until it has ended. */
export async function* buildEvents(build, signal) {
  const response = await request(path("database", "builds", build, "events"), { signal });
  for await (const data of eventData(response.body)) yield JSON.parse(data);
}

/** Return a WebSocket to a session's stream, with the key. */
export function openStream(session) {
  const where = new URL(address(`${path("sessions", session)}/stream`));
  where.protocol = where.protocol.replace("http", "ws");
  const key = storedKey.get();
  // A browser can't set the header of a WebSocket.
  return key ? new WebSocket(where, ["roomfix", `roomfix.key.${key}`]) : new WebSocket(where);
}

function authorization() {
  const key = storedKey.get();
  return key ? { Authorization: `Bearer ${key}` } : {};
}

async function keyEntered(error) {
  if (error.status !== 401) return false;
  const key = await askForKey(error.message);
  if (key) storedKey.set(key);
  return Boolean(key);
}

async function reach(call) {
  try {
    return await call();
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ApiError(0, "unreachable", "The server can't be reached. Is it running, and is the network there?");
  }
}

function problem(status, text) {
  try {
    const body = JSON.parse(text);
    if (body.detail) return new ApiError(status, body.code, String(body.detail));
  } catch {
    // Not from Roomfix: a proxy in between answers in its own words.
  }
  return new ApiError(status, "http_error", `The server answered with status ${status}.`);
}

function send(method, where, headers, body, onProgress, signal) {
  return new Promise((resolve, reject) => {
    const xhr = new XMLHttpRequest();
    xhr.open(method, address(where));
    for (const [name, value] of Object.entries({ ...authorization(), ...headers })) xhr.setRequestHeader(name, value);
    xhr.upload.addEventListener("progress", (event) => onProgress(event.loaded));
    xhr.addEventListener("load", () => resolve({ status: xhr.status, text: xhr.responseText }));
    xhr.addEventListener("error", () =>
      reject(new ApiError(0, "unreachable", "The upload broke off: the server can't be reached.")),
    );
    xhr.addEventListener("abort", () => reject(new DOMException("The upload was cancelled.", "AbortError")));
    signal.addEventListener("abort", () => xhr.abort());
    xhr.send(body);
  });
}
