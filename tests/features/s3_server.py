"""An S3-compatible server (moto) behind a proxy that counts requests and makes them fail.

Prints its address, then reads one command a line from standard input and answers with one line of JSON:

    faults KIND COUNT   the next COUNT requests of objects fail: `busy` (503), `slow` (1 s late), `cut` (half of the body), `refused` (403)
    requests            requests of objects since the last question, as [method, path, range]
    change KEY          overwrites the middle of an object with zeros
    remove KEY          removes an object
    keys                names of all objects
"""

import http.client
import http.server
import json
import sys
import threading
import time

import boto3
from moto.server import ThreadedMotoServer

BUCKET = "league"

server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
server.start()
host, port = server.get_host_and_port()
client = boto3.client(
    "s3",
    endpoint_url=f"http://127.0.0.1:{port}",
    region_name="us-east-1",
    aws_access_key_id="test",
    aws_secret_access_key="test",
)
client.create_bucket(Bucket=BUCKET)

lock = threading.Lock()
faults = []
requests = []


class Proxy(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def log_message(self, *_):
        pass

    def forward(self):
        with lock:
            requests.append([self.command, self.path, self.headers.get("Range")])
            fault = faults.pop(0) if faults else None
        length = int(self.headers.get("Content-Length") or 0)
        body = self.rfile.read(length)
        if fault == "slow":
            time.sleep(1)
        if fault in ("busy", "refused"):
            status, text = (503, b"<Error><Code>SlowDown</Code></Error>") if fault == "busy" else (403, b"<Error><Code>AccessDenied</Code></Error>")
            self.send_response(status)
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(text)
            return
        there = http.client.HTTPConnection("127.0.0.1", port)
        headers = {name: value for name, value in self.headers.items() if name.lower() != "connection"}
        there.request(self.command, self.path, body, headers)
        answer = there.getresponse()
        content = answer.read()
        self.send_response(answer.status)
        for name, value in answer.getheaders():
            if name.lower() not in ("connection", "transfer-encoding", "content-length", "server", "date"):
                self.send_header(name, value)
        size = answer.getheader("Content-Length") if self.command == "HEAD" else str(len(content))
        self.send_header("Content-Length", size or "0")
        self.end_headers()
        if fault == "cut" and self.command == "GET":
            self.wfile.write(content[: len(content) // 2])
            self.wfile.flush()
            self.close_connection = True
            self.connection.shutdown(2)
            return
        self.wfile.write(content)

    do_GET = do_PUT = do_POST = do_HEAD = do_DELETE = forward


proxy = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Proxy)
threading.Thread(target=proxy.serve_forever, daemon=True).start()
print(f"http://127.0.0.1:{proxy.server_address[1]}", flush=True)

for line in sys.stdin:
    command, *words = line.split()
    answer = None
    if command == "faults":
        with lock:
            faults[:] = [words[0]] * int(words[1])
    elif command == "requests":
        with lock:
            answer, requests[:] = list(requests), []
    elif command == "change":
        content = bytearray(client.get_object(Bucket=BUCKET, Key=words[0])["Body"].read())
        middle = len(content) // 2
        content[middle - 20000 : middle + 20000] = bytes(40000)
        client.put_object(Bucket=BUCKET, Key=words[0], Body=bytes(content))
    elif command == "remove":
        client.delete_object(Bucket=BUCKET, Key=words[0])
    elif command == "keys":
        answer = [it["Key"] for it in client.list_objects_v2(Bucket=BUCKET).get("Contents", [])]
    print(json.dumps(answer), flush=True)
