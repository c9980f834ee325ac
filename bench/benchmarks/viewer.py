"""A read-only viewer of a live run, which prints the number of rows; its argument is the URL."""

import json
import sys
import time
import urllib.request

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

_AGAIN_S = 0.5


def main() -> None:
    """Fetch the page until it exists, then read its feed to the end."""
    page = sys.argv[1]
    while True:
        with urllib.request.urlopen(page) as answer:
            if b'id="data"' in answer.read():
                break
        time.sleep(_AGAIN_S)
    rows = 0
    with connect(page.replace("http:", "ws:") + "feed", max_size=None) as feed:
        try:
            while True:
                rows += len(json.loads(feed.recv()).get("append", {}).get("pool", {}).get("t", []))
        except ConnectionClosed:
            sys.stdout.write(f"{rows}\n")
