"""Walks through the page in a browser and prints the views a second that it shows, as JSON.

Arguments: the page's address with the pose to begin at, the browser's program. The browser is told by its DevTools protocol to hold a key."""

import asyncio
import itertools
import json
import os
import re
import subprocess
import sys
import tempfile
import urllib.request
from pathlib import Path

from websockets.asyncio.client import connect

WARM_UP_S = 3
SAMPLES = 8
# Left and right in turn, so that the camera stays where images are.
TURNS = itertools.cycle("qe")
CAPTION = "document.querySelector('#figure-exact figcaption').textContent"
SIZE = "[document.querySelector('#figure-exact canvas').width, document.querySelector('#figure-exact canvas').height].join('x')"


async def call(socket, numbers, method, **parameters):
    number = next(numbers)
    await socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
    while (answer := json.loads(await socket.recv())).get("id") != number:
        pass
    return answer["result"]


async def evaluated(socket, numbers, expression):
    return (await call(socket, numbers, "Runtime.evaluate", expression=expression))["result"]["value"]


async def walk(page):
    numbers = itertools.count(1)
    async with connect(page["webSocketDebuggerUrl"], max_size=None) as socket:
        rates = []
        for second in range(WARM_UP_S + SAMPLES):
            key = next(TURNS)
            await call(socket, numbers, "Input.dispatchKeyEvent", type="keyDown", key=key)
            await asyncio.sleep(1)
            await call(socket, numbers, "Input.dispatchKeyEvent", type="keyUp", key=key)
            shown = await evaluated(socket, numbers, CAPTION)
            rate = re.search(r"(\d+) views/s", shown)
            if second >= WARM_UP_S:
                rates.append(int(rate[1]) if rate else 0)
        size = await evaluated(socket, numbers, SIZE)
    mean, load = sum(rates) / len(rates), os.getloadavg()[0]
    print(json.dumps({"size": size, "views_per_s": rates, "mean": mean, "load": load, "shown": shown}))


async def first_page(profile):
    for _ in range(200):
        await asyncio.sleep(0.1)
        port = profile / "DevToolsActivePort"
        if not port.exists():
            continue
        with urllib.request.urlopen(f"http://127.0.0.1:{port.read_text().split()[0]}/json/list") as answer:
            pages = [page for page in json.load(answer) if page["type"] == "page"]
        if pages:
            return pages[0]
    raise SystemExit("the browser shows no page")


async def main(url, program):
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = ["--headless=new", "--no-sandbox", "--remote-debugging-port=0", "--window-size=1280,900"]
        browser = subprocess.Popen([program, *options, f"--user-data-dir={profile}", url], stderr=subprocess.DEVNULL)
        try:
            await walk(await first_page(Path(profile)))
        finally:
            browser.terminate()
            browser.wait()


asyncio.run(main(*sys.argv[1:]))
