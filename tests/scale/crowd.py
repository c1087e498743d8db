"""Many connections at once: the daemon's resident memory and its slowest status (docs/reliability/http.md).

Usage: crowd.py PORT PID [CONNECTIONS]   on this machine, of a daemon that captures; loopback, no token

Each crowd opens its connections, sends as much as the daemon takes, reads no answer and stays for eight seconds.
"""

import resource
import socket
import sys
import threading
import time
import urllib.request

PORT, PID = int(sys.argv[1]), int(sys.argv[2])
MOST = int(sys.argv[3]) if len(sys.argv) > 3 else 900
STAY_S = 8
BODY = b'{"name":"' + b"x" * 65400
POST = b"POST %s HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 65500\r\n\r\n"
GET = b"GET %s HTTP/1.1\r\nHost: localhost\r\n\r\n"


def memory_mib(name):
    with open(f"/proc/{PID}/status", encoding="ascii") as file:
        return next(int(line.split()[1]) for line in file if line.startswith(name)) / 1024


def ask_status(slowest, stop):
    while not stop.is_set():
        begun = time.monotonic()
        urllib.request.urlopen(f"http://127.0.0.1:{PORT}/v1/status", timeout=60).read()
        slowest.append(time.monotonic() - begun)
        time.sleep(0.1)


def crowd(name, count, data):
    sockets = [[socket.create_connection(("127.0.0.1", PORT)), 0] for _ in range(count)]
    slowest, stop = [], threading.Event()
    asking = threading.Thread(target=ask_status, args=(slowest, stop))
    asking.start()
    most, end = 0.0, time.monotonic() + STAY_S
    for one, _ in sockets:
        one.setblocking(False)
    while time.monotonic() < end:
        for pair in sockets:
            try:
                pair[1] += pair[0].send(data[pair[1] : pair[1] + 32768]) if pair[1] < len(data) else 0
            except OSError:
                pass
        time.sleep(0.05)
        most = max(most, memory_mib("VmRSS"))
    for one, _ in sockets:
        one.close()
    stop.set()
    asking.join()
    print(f"{count} x {name}: {most:.0f} MiB, slowest status {max(slowest):.3f} s", flush=True)
    time.sleep(1)


resource.setrlimit(resource.RLIMIT_NOFILE, (4096, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
print(f"before: {memory_mib('VmRSS'):.0f} MiB")
crowd("a body that stops", MOST, POST % b"/v1/jobs" + BODY)
crowd("GET /captures/latest, unread", MOST, GET % b"/captures/latest" * 600)
for count in (20, MOST // 9, MOST * 5 // 9):
    crowd("GET /openapi.json, unread", count, GET % b"/openapi.json" * 600)
print(f"at most {memory_mib('VmHWM'):.0f} MiB")
