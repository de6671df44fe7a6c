// Requests to the console, and who this page is.

// A duplicated tab copies the storage of the first, so the id is checked against the other tabs.
const KEY = "rig-viewer";
let me = sessionStorage.getItem(KEY) ?? fresh();

function fresh() {
  const id = Array.from(crypto.getRandomValues(new Uint8Array(12)), (byte) => byte.toString(16).padStart(2, "0")).join("");
  sessionStorage.setItem(KEY, id);
  return id;
}

/** This page's id. */
export function viewer() {
  return me;
}

/** Makes sure that no other open tab has this page's id. */
export async function settleIdentity() {
  if (!("BroadcastChannel" in window)) return;
  const channel = new BroadcastChannel("rig-viewers");
  const nonce = Math.random();
  await new Promise((settled) => {
    channel.onmessage = ({ data }) => {
      if (data.id !== me || data.nonce === nonce) return;
      if (data.question) channel.postMessage({ id: me, nonce: data.nonce, answer: true });
      else if (data.answer) return;
    };
    const replies = new BroadcastChannel("rig-viewers");
    replies.onmessage = ({ data }) => {
      if (data.answer && data.nonce === nonce) me = fresh();
    };
    channel.postMessage({ id: me, nonce, question: true });
    setTimeout(() => {
      replies.close();
      settled();
    }, 60);
  });
}

/** What an action or a question failed with. */
export class Refused extends Error {
  constructor(fact, hint, status) {
    super(fact);
    this.hint = hint;
    this.status = status;
  }
}

async function answer(request) {
  let response;
  try {
    response = await request;
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Refused("the console did not answer", "check that rig still runs at its terminal", 0);
  }
  const text = await response.text();
  let body = null;
  try {
    body = text === "" ? {} : JSON.parse(text);
  } catch {
    body = { error: `the console answered ${response.status} without JSON` };
  }
  if (response.ok) return body;
  throw new Refused(body?.error ?? `the console answered ${response.status}`, body?.hint ?? null, response.status);
}

/**
 * A browser opens six connections to one address, and all that waits for an answer holds one.
 * Questions keep to so many: with the stream and the picture one is left for STOP.
 */
const MOST_QUESTIONS = 3;
const questions = new Set();
const turns = [];

/** A question, in its turn; `read` makes what is asked for of the answer. */
async function inTurn(send, signal, read = answer) {
  while (questions.size >= MOST_QUESTIONS) await new Promise((turn) => turns.push(turn));
  const mine = new AbortController();
  if (signal?.aborted) mine.abort();
  signal?.addEventListener("abort", () => mine.abort());
  questions.add(mine);
  try {
    return await read(send(mine.signal));
  } finally {
    questions.delete(mine);
    turns.shift()?.();
  }
}

/** Reads an address. */
export function ask(address, signal) {
  return inTurn((until) => fetch(address, { signal: until, cache: "no-store" }), signal);
}

/** Reads a picture as a blob; null where there is none. */
export function askPicture(address) {
  const read = async (request) => {
    const response = await request;
    return response.ok ? response.blob() : null;
  };
  return inTurn((until) => fetch(address, { signal: until }), undefined, read);
}

/** A question that takes a form, such as a dry run. */
export function askWith(address, body, signal) {
  return inTurn((until) => post(address, body, until), signal);
}

/** STOP waits behind no question of this page. */
export function giveUpQuestions() {
  for (const question of questions) question.abort();
}

/** Carries out an action. */
export function act(address, body = {}) {
  return answer(post(address, body));
}

function post(address, body, signal) {
  return fetch(address, {
    method: "POST",
    signal,
    priority: "high",
    headers: { "Content-Type": "application/json", "X-Rig-Viewer": me },
    body: JSON.stringify(body),
  });
}
