"""Cameras on the network: a JPEG over RTSP (RFC 2326, RTP over TCP, RFC 2435) and over HTTP (multipart)."""

from __future__ import annotations

import contextlib
import http.server
import socketserver
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

FRAME_S = 0.04
PAYLOAD_BYTES = 1400
JPEG_CLOCK_HZ = 90_000


class Camera:
    """What is served: the picture it shows now, how many clients came, and whether it is broken."""

    def __init__(self, jpeg: bytes) -> None:
        self.jpeg = jpeg
        self.clients = 0
        self.broken = threading.Event()


@contextmanager
def mjpeg_stream(camera: Camera) -> Iterator[str]:
    """Serve a camera over HTTP as one picture after another; give its URL."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            camera.clients += 1
            self.send_response(503 if camera.broken.is_set() else 200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            with contextlib.suppress(OSError):
                while not camera.broken.is_set():
                    head = (
                        f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(camera.jpeg)}\r\n\r\n"
                    )
                    self.wfile.write(head.encode() + camera.jpeg + b"\r\n")
                    time.sleep(FRAME_S)

        def log_message(self, *_: object) -> None:
            pass

    with _served(http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)) as port:
        yield f"http://127.0.0.1:{port}/stream.mjpg"


@contextmanager
def rtsp_stream(camera: Camera) -> Iterator[str]:
    """Serve a camera over RTSP; give its URL."""

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            camera.clients += 1
            with contextlib.suppress(OSError):
                _talk(self.rfile.readline, self.wfile.write, camera)

    class Listener(socketserver.ThreadingTCPServer):
        allow_reuse_address = True
        daemon_threads = True

    with _served(Listener(("127.0.0.1", 0), Handler)) as port:
        yield f"rtsp://127.0.0.1:{port}/camera"


@contextmanager
def _served(server: socketserver.TCPServer) -> Iterator[int]:
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()


def _talk(read_line: Callable[[], bytes], write: Callable[[bytes], object], camera: Camera) -> None:
    """Answer the requests of one client until it asks for pictures, then send them."""
    while request := _request(read_line):
        method, url, sequence = request
        fields, body = {"CSeq": sequence}, b""
        if method == "OPTIONS":
            fields["Public"] = "OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN"
        elif method == "DESCRIBE":
            body = b"v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nt=0 0\r\nm=video 0 RTP/AVP 26\r\na=control:0\r\n"
            fields |= {"Content-Type": "application/sdp", "Content-Base": url + "/"}
        elif method == "SETUP":
            fields |= {"Transport": "RTP/AVP/TCP;unicast;interleaved=0-1", "Session": "1"}
        elif method == "PLAY":
            fields["Session"] = "1"
        head = "".join(f"{name}: {value}\r\n" for name, value in fields.items())
        status = "503 Service Unavailable" if camera.broken.is_set() else "200 OK"
        write(f"RTSP/1.0 {status}\r\n{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        if method == "PLAY":
            break
    number, stamp = 0, 0
    while request and not camera.broken.is_set():
        for packet in rtp_packets(camera.jpeg, number, stamp):
            write(b"$\x00" + struct.pack(">H", len(packet)) + packet)
            number += 1
        stamp += int(FRAME_S * JPEG_CLOCK_HZ)
        time.sleep(FRAME_S)


def _request(read_line: Callable[[], bytes]) -> tuple[str, str, str] | None:
    first = read_line().decode()
    if not first:
        return None
    sequence = "0"
    while line := read_line().decode().strip():
        name, _, value = line.partition(":")
        if name.lower() == "cseq":
            sequence = value.strip()
    method, url, _ = first.split()
    return method, url, sequence


def rtp_packets(jpeg: bytes, number: int, stamp: int) -> list[bytes]:
    """Return a baseline JPEG with 4:2:0 colours as RTP packets: its tables and what is coded, without its headers."""
    tables, size, scan = b"", (0, 0), b""
    at = 2
    while True:
        marker, length = jpeg[at + 1], struct.unpack(">H", jpeg[at + 2 : at + 4])[0]
        segment = jpeg[at + 4 : at + 2 + length]
        if marker == 0xDB:
            tables += b"".join(segment[i + 1 : i + 65] for i in range(0, len(segment), 65))
        elif marker == 0xC0:
            height, width = struct.unpack(">HH", segment[1:5])
            size = (width // 8, height // 8)
        at += 2 + length
        if marker == 0xDA:
            scan = jpeg[at:-2]
            break
    packets, offset = [], 0
    while offset < len(scan):
        part = scan[offset : offset + PAYLOAD_BYTES]
        last = offset + len(part) == len(scan)
        head = struct.pack(
            ">BBHII", 0x80, (0x80 if last else 0) | 26, (number + len(packets)) & 0xFFFF, stamp, 1
        )
        head += struct.pack(">I", offset) + bytes([1, 255, *size])
        if offset == 0:
            head += struct.pack(">BBH", 0, 0, len(tables)) + tables
        packets.append(head + part)
        offset += len(part)
    return packets
