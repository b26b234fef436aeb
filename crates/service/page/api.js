// Asks the service, with the token if it wants one, and says when it does not answer.

const TOKEN = 'realitysim-token';
const status = document.getElementById('status');
let asking = null;

/** What the service refuses; `message` is its own explanation. */
export class Refused extends Error {
  constructor(code, message) {
    super(message);
    this.code = code;
  }
}

/**
 * Fetches a path. Throws `Refused` for an answer that is none, and `TypeError` if there is no answer.
 * Who is patient asks again while the service is busy.
 */
export async function ask(path, { accept = 'application/json', patient = false, order } = {}) {
  const headers = { Accept: accept };
  const token = sessionStorage.getItem(TOKEN);
  if (token) headers.Authorization = `Bearer ${token}`;
  let answer;
  try {
    const body = order && JSON.stringify({ order });
    if (order) headers['Content-Type'] = 'application/json';
    answer = await fetch(path, { method: order ? 'POST' : 'GET', body, headers, cache: 'no-store' });
  } catch (error) {
    say('The service does not answer. Is realitysim serve still running?');
    throw error;
  }
  if (answer.status === 401) {
    await askForToken();
    return ask(path, { accept, patient, order });
  }
  if (answer.status === 503 && patient) {
    await pause(500);
    return ask(path, { accept, patient, order });
  }
  if (answer.status !== 503) say('');
  if (!answer.ok) throw new Refused(answer.status, await detail(answer));
  return answer;
}

export async function askJson(path, options) {
  return (await ask(path, options)).json();
}

/** Shows a message about the service itself; an empty one takes it away. */
export function say(message) {
  if (status.textContent !== message) status.textContent = message;
}

async function detail(answer) {
  try {
    return (await answer.json()).detail ?? answer.statusText;
  } catch {
    return answer.statusText;
  }
}

function askForToken() {
  asking ??= new Promise((resolve) => {
    const dialog = document.getElementById('token-dialog');
    const input = document.getElementById('token');
    input.value = '';
    dialog.addEventListener('close', () => {
      sessionStorage.setItem(TOKEN, input.value.trim());
      asking = null;
      resolve();
    }, { once: true });
    dialog.showModal();
  });
  return asking;
}

export const pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));
