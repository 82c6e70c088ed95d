"""The server of `nnpp-edge view`: who is answered, tabs that come and go, and how it ends."""

import http.client
import json
import socket
import subprocess
from contextlib import ExitStack

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from tests.view_cases import COMMAND, serving, write_ground


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    path = write_ground(tmp_path_factory.mktemp("ground"))
    with serving(path, "--limit", "hard_slope_deg=25") as running:
        yield running
        assert running.end() == (0, "")  # Ctrl-C, after all that the tests did


def get(server, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), content


def tab(server, origin=None, **more):
    own = f"http://127.0.0.1:{server.port}"
    return connect(f"ws://127.0.0.1:{server.port}/live", origin=own if origin is None else origin, **more)


def ask(connection, kind="path", **message):
    """Send a message, and the next answer of a kind."""
    connection.send(json.dumps(message))
    while True:
        answer = connection.recv(timeout=20)
        if isinstance(answer, str) and (found := json.loads(answer))["type"] in (kind, "problem"):
            return found


def test_only_this_machines_own_pages_are_answered(server):
    status, headers, content = get(server)
    assert status == 200 and b"<title>nnpp-edge view" in content
    assert "default-src 'none'" in headers["content-security-policy"]
    assert get(server, "/page/app.js")[0] == 200
    assert get(server, "/page/../server.py")[0] == 404
    assert get(server, Host="evil.example:80")[0] == 400
    assert get(server, Host=f"localhost:{server.port}")[0] == 200
    for origin in ("http://evil.example", "null", f"http://127.0.0.1:{server.port + 1}"):
        with pytest.raises(InvalidStatus):
            tab(server, origin=origin)
    with pytest.raises(InvalidStatus):
        connect(f"ws://127.0.0.1:{server.port}/live")


def test_a_tab_too_many_is_told_so(server):
    with ExitStack() as tabs:
        for _ in range(8):
            each = tabs.enter_context(tab(server))
            assert ask(each, type="move", end="goal", to=[80, 20])["ok"]
        with tab(server) as ninth:
            told = json.loads(ninth.recv(timeout=20))
    assert told == {"type": "problem", "number": 0, "text": "8 tabs are open: close one"}


def test_two_tabs_know_nothing_of_each_other(server):
    with tab(server) as one, tab(server) as other:
        first = ask(one, type="move", end="goal", to=[80, 20])
        assert ask(other, type="move", end="start", to=[5, 5])["goal"] != first["goal"]
        painted = ask(one, type="paint", part=[30, 8, 10, 10])
        assert painted["obstacles"] == [[30, 8, 10, 10]]
        assert ask(other, type="move", end="start", to=[6, 6])["obstacles"] == []


def test_a_tab_that_closes_while_it_waits_leaves_the_others_alone(server):
    for _ in range(3):
        with tab(server) as lost:
            lost.send(json.dumps({"type": "change", "values": {"step_cost": "tobler"}}))
            lost.socket.close()
    with tab(server) as still:
        assert ask(still, type="move", end="goal", to=[80, 20])["ok"]


def test_nonsense_is_answered_in_a_line(server):
    with tab(server) as connection:
        for text in (
            "",
            "no",
            '{"type": "change", "values": {"omega": "x"}}',
            '{"type": "paint", "part": [0, 0, 0, 0]}',
        ):
            connection.send(text)
            answer = json.loads(connection.recv(timeout=20))
            assert answer["type"] == "problem" and "\n" not in answer["text"]
        assert ask(connection, type="move", end="goal", to=[80, 20])["ok"]
        connection.send("x" * (1 << 17))
        with pytest.raises(ConnectionClosed) as closed:
            connection.recv(timeout=20)
        assert closed.value.rcvd.code == 1009  # too big


def test_a_taken_port_is_refused_in_a_line(nnpp_edge, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ended = nnpp_edge("view", write_ground(tmp_path), "--port", port, "--no-browser")
    ended.refused(f"port {port} on 127.0.0.1 cannot be used", "--port")


def test_a_broken_file_is_refused_in_a_line(nnpp_edge, bad_dem):
    path, word = bad_dem
    nnpp_edge("view", path, "--port", "0", "--no-browser").refused(word)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--step-cost", "energy"), "mobility.energy"),
        (("--vehicle", "hovercraft"), "hovercraft"),
        (("--limit", "hard_slope_deg=0.001"), "all impassable"),
        (("--start", "lonlat:1,2"), "coordinate system"),
    ],
)
def test_what_cannot_be_planned_on_is_refused_in_a_line(nnpp_edge, tmp_path, words, said):
    nnpp_edge("view", write_ground(tmp_path), *words, "--port", "0", "--no-browser").refused(said)


def test_it_says_which_package_is_missing(tmp_path):
    code = "import sys; sys.modules['uvicorn'] = None; from nnpp_edge.cli.main import main; main()"
    words = [COMMAND[0], "-c", code, "view", str(write_ground(tmp_path)), "--no-browser"]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (
        2,
        "error: nnpp-edge view needs uvicorn: pip install 'nnpp-edge[view]'\n",
    )
