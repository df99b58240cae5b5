"""The process that serves the page: ``python -m bo_tuner.web SOCKET``; stdin has the run."""

import asyncio
import json
import os
import socket
import sys

from threadpoolctl import threadpool_limits

from bo_tuner.web.server import serve

NICENESS = 10
"""The run comes first."""

if __name__ == "__main__":
    os.nice(NICENESS)
    listening = socket.socket(fileno=int(sys.argv[1]))
    settings = json.loads(sys.stdin.buffer.readline())
    with threadpool_limits(1):
        asyncio.run(serve(listening, settings, sys.stdin.buffer))
