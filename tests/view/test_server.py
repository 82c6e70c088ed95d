"""The server of `nnpp-edge view`: who is answered, connections that come and go, and how
it ends.
"""

import http.client
import json
import socket
import threading

import pytest

from nnpp_edge.view.server import PageServer
from tests.view_cases import serving, write_ground

HALF = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"
WHOLE = HALF + b"\r\n"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    path = write_ground(tmp_path_factory.mktemp("ground"))
    with serving(path, "--limit", "hard_slope_deg=25") as running:
        yield running
        assert running.end() == (0, "")  # Ctrl-C, after all that the tests did


def got(port, path="/", body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    method = "GET" if body is None else "POST"
    connection.request(method, path, body, {"Origin": f"http://127.0.0.1:{port}"} | headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), content


def test_only_this_machines_own_pages_are_answered(server):
    status, headers, content = got(server.port)
    assert status == 200 and b"<title>nnpp-edge view" in content
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    _, headers, _ = got(server.port, "/page/app.js")
    assert "javascript" in headers["Content-Type"]
    for path in ("/page/../server.py", "/page/", "/ask", "/favicon.ico"):
        assert got(server.port, path)[0] == 404
    assert got(server.port, Host="evil.example:80")[0] == 400
    assert got(server.port, Host=f"localhost:{server.port}")[0] == 200
    for origin in ("http://evil.example", "null", f"http://127.0.0.1:{server.port + 1}", ""):
        assert got(server.port, "/ask", b"{}", Origin=origin)[0] == 403
    assert (
        got(server.port, "/ask", b"{}", Host="evil.example", Origin="http://evil.example")[0] == 403
    )


def test_questions_are_answered_and_what_is_too_long_is_not_read(server):
    asked = json.loads(got(server.port, "/opening")[2])["asked"]
    asked = {name: asked[name] for name in ("start", "goal")} | {"goal": [80, 20]}
    status, _, content = got(server.port, "/ask", json.dumps({"want": "path", "asked": asked}))
    assert status == 200 and json.loads(content)["ok"]
    assert b"cannot be read" in got(server.port, "/ask", b"no")[2]
    assert got(server.port, "/ask", b"x" * (1 << 17))[0] == 413
    assert got(server.port, "/other", b"{}")[0] == 404


def test_lengths_that_make_no_sense_are_answered_in_a_line(server):
    """Python refuses to convert 5,000 digits; the server's end says that it printed nothing."""
    for length, code in ((1 << 29, b" 413 "), ("9" * 5000, b" 400 "), (-1, b" 400 ")):
        with socket.create_connection(("127.0.0.1", server.port)) as large:
            head = (
                HALF.replace(b"GET /", b"POST /ask")
                + f"Origin: http://127.0.0.1\r\nContent-Length: {length}\r\n\r\n".encode()
            )
            large.sendall(head)
            assert code in large.recv(1 << 16)


def test_it_tells_what_it_waits_for_while_it_plans():
    class Slow:
        notice = "compiling"
        begun = threading.Event()
        done = threading.Event()

        def answer(self, question):
            self.begun.set()
            self.done.wait(40.0)  # longer than `got` waits
            return b"{}"

    with PageServer(0) as running:
        running.answerer = slow = Slow()
        threading.Thread(target=running.serve, daemon=True).start()
        port = running.server_address[1]
        asking = threading.Thread(target=got, args=(port, "/ask", b"{}"))
        asking.start()
        assert slow.begun.wait(20.0)
        assert json.loads(got(port, "/news")[2]) == {"notice": "compiling"}
        slow.done.set()
        asking.join()
        running.shutdown()


def test_a_tab_that_closes_while_it_waits_leaves_the_others_alone(server):
    asked = {"start": [8, 8], "goal": [80, 20], "step_cost": "tobler"}
    body = json.dumps({"want": "path", "asked": asked}).encode()
    head = (
        "POST /ask HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://127.0.0.1\r\nContent-Length: "
        f"{len(body)}\r\n\r\n"
    )
    for sent in (body, body[:20]):
        with socket.create_connection(("127.0.0.1", server.port)) as lost:
            lost.sendall(head.encode() + sent)
    assert json.loads(got(server.port, "/ask", body)[2])["ok"]


@pytest.fixture
def page(monkeypatch):
    """A server in a thread, and what connects to it."""
    monkeypatch.setattr("nnpp_edge.view.server._Handler.timeout", 0.2)
    opened = []
    with PageServer(0) as running:
        threading.Thread(target=running.serve, daemon=True).start()

        def opening(sent):
            opened.append(socket.create_connection(running.server_address, timeout=5))
            opened[-1].sendall(sent)
            return opened[-1]

        yield opening
        for each in opened:
            each.close()
        running.shutdown()


def closed(connection):
    """Wait until the server has closed it."""
    try:
        while connection.recv(1 << 16):
            pass
    except ConnectionResetError:
        pass
    return True


def test_a_connection_that_sends_nothing_or_half_a_request_is_closed_after_a_while(page, capfd):
    for sent in (
        b"",
        HALF,
        WHOLE,
        HALF.replace(b"GET /", b"POST /ask") + b"Content-Length: 9\r\n\r\n",
    ):
        assert closed(page(sent))
    assert capfd.readouterr() == ("", "")


def test_a_taken_port_is_refused_in_a_line(nnpp_edge, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ended = nnpp_edge("view", write_ground(tmp_path), "--port", port, "--no-browser")
    ended.refused(f"port {port} on 127.0.0.1 cannot be used", "--port")
