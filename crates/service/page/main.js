// The tabs of the page, and the address line: what is shown can be shown again by its link.

import * as walk from './walk.js';
import * as captures from './captures.js';
import * as live from './live.js';
import { askJson, pause, say } from './api.js';

const TABS = { walk, captures, live };
let shown = null;
/** The tab of an address that names none: a service without a database watches a robot. */
let first = 'walk';

/** The tab and the parameters that the address line names. */
function address() {
  const [name, query = ''] = location.hash.replace(/^#/, '').split('?');
  return { name: name in TABS ? name : first, parameters: new URLSearchParams(query) };
}

/** Puts the state of a tab into the address line. */
function remember(name, parameters) {
  if (name !== shown) return;
  const query = new URLSearchParams(parameters).toString();
  history.replaceState(null, '', `#${name}${query ? `?${query}` : ''}`);
}

function show(name, parameters) {
  shown = name;
  for (const tab of Object.keys(TABS)) {
    // Not the name alone: the browser scrolls to an element whose id is in the address line.
    document.getElementById(`panel-${tab}`).hidden = tab !== name;
    const button = document.getElementById(`tab-${tab}`);
    button.setAttribute('aria-selected', String(tab === name));
    button.tabIndex = tab === name ? 0 : -1;
    if (tab !== name) TABS[tab].hide();
  }
  TABS[name].show(parameters);
}

function openTab(name) {
  if (name === shown) return;
  location.hash = name;
}

async function start() {
  for (const name of Object.keys(TABS)) {
    const button = document.getElementById(`tab-${name}`);
    button.addEventListener('click', () => openTab(name));
    button.addEventListener('keydown', (event) => {
      if (event.key !== 'ArrowLeft' && event.key !== 'ArrowRight') return;
      event.preventDefault();
      event.stopPropagation();
      const names = Object.keys(TABS);
      const other = names[(names.indexOf(name) + (event.key === 'ArrowLeft' ? -1 : 1) + names.length) % names.length];
      openTab(other);
      document.getElementById(`tab-${other}`).focus();
    });
  }
  const info = await service();
  if (!info.field) first = 'live';
  for (const [name, tab] of Object.entries(TABS)) tab.start(info, (parameters) => remember(name, parameters));
  const open = () => {
    const { name, parameters } = address();
    show(name, parameters);
  };
  addEventListener('hashchange', open);
  open();
}

/** What the service has; asked until it answers. */
async function service() {
  for (;;) {
    try {
      return await askJson('/v1/info');
    } catch (error) {
      if (error.code) say(error.message);
      await pause(2000);
    }
  }
}

start();
