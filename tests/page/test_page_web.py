"""The page's server without a browser: its files, who is answered, with which headers, at which address."""

import json
import re
import socket
from pathlib import Path

import pytest

from onboard.page import address as addresses
from onboard.page import process, web
from onboard.page.follow import LogFrames
from onboard.recording.reader import LogReader
from tests.page.served import ask, raw, served

TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
STATIC = Path(web.__file__).parent / "static"
FOREIGN = "Origin: http://example.org"


@pytest.fixture(scope="module")
def log(made_log: Path) -> LogFrames:
    return LogFrames(LogReader(made_log))


class TestFiles:
    def test_every_file_of_the_page_comes_with_its_type_and_the_policy(self, log: LogFrames) -> None:
        with served(log) as one:
            names = [path.name for path in STATIC.iterdir()] + ["theme.css"]
            assert {"index.html", "page.js", "page.css", "format.js", "course.js", "icon.svg"} <= set(names)
            for name in names:
                reply = ask(one.port, f"/{name}")
                assert reply.status == 200
                assert reply.headers["Content-Type"].split(";")[0] == TYPES[name.rpartition(".")[2]]
                assert {key: reply.headers[key] for key in web.HEADERS} == web.HEADERS
                assert int(reply.headers["Content-Length"]) == len(reply.body)
            assert ask(one.port, "/").body == (STATIC / "index.html").read_bytes()
            for path in ("/nothing", "/static/page.js", "/../address.py", "/%2e%2e/address.py", "/live", "/frame/x"):
                assert ask(one.port, path).status == 404

    def test_signals_by_name_and_time(self, log: LogFrames) -> None:
        with served(log) as one:
            assert json.loads(ask(one.port, "/signals").body) == {
                "names": ["joint_1", "estimator rows", "innovation line 1"],
                "signal": None,
            }
            for query in ("?name=nothing", "?name=joint_1&since=x", "?since=1", "?%00", "?name=joint_1%20"):
                assert json.loads(ask(one.port, f"/signals{query}").body)["signal"] is None
            found = json.loads(ask(one.port, "/signals?name=joint_1").body)["signal"]
            assert (found["unit"], found["components"], found["every_s"]) == ("rad", [""], 0.05)
            assert [found["points"][0], len(found["points"])] == [[0.0, 0.0, 0.004], 200]
            later = json.loads(ask(one.port, "/signals?name=joint_1&since=9.9").body)["signal"]
            assert later["points"] == found["points"][-2:]
            assert json.loads(ask(one.port, "/signals?name=joint_1&since=nan").body)["signal"]["points"] == []

    def test_the_policy_allows_nothing_inline_and_nothing_from_elsewhere(self) -> None:
        policy = dict(part.strip().split(" ", 1) for part in web.HEADERS["Content-Security-Policy"].split(";"))
        assert policy["default-src"] == "'none'"
        assert set(policy.values()) == {"'none'", "'self'"}
        for path in STATIC.iterdir():
            text = path.read_text()
            assert not re.search(r"\bon\w+=[\"']|<style|style=|javascript:", text) or path.suffix == ".js"
            found = re.findall(r"(?:https?:)?//[a-z][\w.-]+", text)
            assert set(found) <= {"http://www.w3.org"}
            assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|DOMParser|\beval\b", text)
        scripts = re.findall(r"<script([^>]*)>(.*?)</script>", (STATIC / "index.html").read_text(), re.DOTALL)
        assert scripts
        assert all("src=" in attributes and not body.strip() for attributes, body in scripts)


class TestWhoIsAnswered:
    @pytest.mark.parametrize("path", ["/", "/page.js", "/flight", "/frame/0"])
    def test_by_host_and_origin(self, log: LogFrames, path: str) -> None:
        with served(log) as one:
            here = f"127.0.0.1:{one.port}"
            for host in (here, f"localhost:{one.port}", "LOCALHOST", "[::1]:80", "192.168.1.7", socket.gethostname()):
                assert ask(one.port, path, host=host).status == 200
            for host in (
                "example.org",
                "127.0.0.1.example.org",
                "localhost.example.org",
                "[::1",
                "a b",
                "localhost@x.org",
            ):
                assert ask(one.port, path, host=host).status == 403
            assert ask(one.port, path, f"Origin: http://{here}").status == 200
            for line in (FOREIGN, "Origin: null", f"Origin: https://{here}", "Origin: http://127.0.0.1:1", "origin:"):
                assert ask(one.port, path, line).status == 403
            assert ask(one.port, path, "Sec-Fetch-Site: same-origin").status == 200
            assert ask(one.port, path, "Sec-Fetch-Site: cross-site", "Sec-Fetch-Mode: no-cors").status == 403
            assert ask(one.port, path, "Sec-Fetch-Site: cross-site", "Sec-Fetch-Mode: navigate").status == 200

    def test_what_is_no_request(self, log: LogFrames) -> None:
        with served(log) as one:
            assert ask(one.port, host_lines=0).status == 400
            assert ask(one.port, host_lines=2).status == 400
            assert ask(one.port, "/", f"Origin: http://127.0.0.1:{one.port}", FOREIGN).status == 400
            for method in ("POST", "HEAD", "PUT", "DELETE", "OPTIONS", "TRACE"):
                assert ask(one.port, "/flight", method=method).status == 405
            for sent in (b"GET / HTTP/2\r\n\r\n", b"\r\n\r\n", b"GET http://x/ HTTP/1.1\r\nHost: localhost\r\n\r\n"):
                assert raw(one.port, sent).status == 400
            assert raw(one.port, bytes(range(256)) * 4 + b"\r\n\r\n").status == 400
            assert ask(one.port, "/", f"X: {'x' * 9000}").status == 431
            assert ask(one.port, "/frame/99999999").status == 404
            assert ask(one.port, "/frame/-1").status == 404
            assert ask(one.port, f"/frame/{'9' * 5000}").status == 404
            assert ask(one.port, "/frame/\u00b2").status in (400, 404)
            assert ask(one.port).status == 200  # it lives

    def test_of_a_network_paths_begin_with_the_token(self, log: LogFrames) -> None:
        with served(log, "0.0.0.0:0") as one:
            assert len(one.token) >= 20
            for path in (
                "/",
                "/flight",
                "/page.js",
                "/x/",
                "//",
                f"/{one.token}",
                f"/{one.token[:-1]}/",
                "/\u00e9/flight",
            ):
                assert ask(one.port, path).status in (400, 404)
                assert b"title" not in ask(one.port, path).body
            assert ask(one.port, f"/{one.token}/").body == (STATIC / "index.html").read_bytes()
            assert json.loads(ask(one.port, f"/{one.token}/flight").body)["title"] == "made: made.mcap"
            assert ask(one.port, f"/{one.token}/flight", FOREIGN).status == 403
            assert ask(one.port, f"/{one.token}/flight", host="flight.local:80").status == 200  # whatever leads here
            assert ask(one.port, "/flight", host="flight.local:80").status == 404

    def test_a_token_is_new_each_time_and_not_for_this_computer(self) -> None:
        every = addresses.parse("0.0.0.0:0")
        assert addresses.token_for(every) != addresses.token_for(every)
        for text in ("", "127.0.0.1", "localhost:9", "[::1]:9", "127.9.9.9:1"):
            assert addresses.token_for(addresses.parse(text)) == ""
        for text in ("0.0.0.0", "[::]:9", "192.168.1.7", "flight-computer"):
            assert addresses.token_for(addresses.parse(text))


class TestAddress:
    @pytest.mark.parametrize(
        ("text", "meant"),
        [
            ("", ("127.0.0.1", 8787, False)),
            (":9000", ("127.0.0.1", 9000, True)),
            ("0.0.0.0", ("0.0.0.0", 8787, False)),
            ("host:1", ("host", 1, True)),
            ("[::1]:80", ("::1", 80, True)),
        ],
    )
    def test_what_is_one(self, text: str, meant: tuple[str, int, bool]) -> None:
        assert addresses.parse(text) == meant

    @pytest.mark.parametrize(
        "text", ["host:port", "host:70000", "host:", "::1", "http://x:1", "a b:1", "x:1:2", "[x]:1"]
    )
    def test_what_is_none(self, text: str) -> None:
        with pytest.raises(ValueError, match="write HOST:PORT"):
            addresses.parse(text)

    def test_what_is_printed_leads_here(self) -> None:
        assert addresses.url(addresses.parse("[::1]:80"), 80, "") == "http://[::1]:80/"
        assert re.fullmatch(r"http://(?!0\.0\.0\.0)[\w.-]+:7/T/", addresses.url(addresses.parse("0.0.0.0:7"), 7, "T"))

    def test_one_that_is_taken(self, log: LogFrames) -> None:
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            port = taken.getsockname()[1]
            with pytest.raises(ValueError, match="give another address"), process.serving(Path("x"), f":{port}"):
                pytest.fail("it said it serves")


def test_frames_of_a_log_are_those_it_has(log: LogFrames) -> None:
    with served(log) as one:
        about = json.loads(ask(one.port, "/flight").body)
        assert (about["live"], len(about["steps"]), len(about["events"])) == (False, len(log), 3)
        for number in (0, len(log) - 1):
            assert ask(one.port, f"/frame/{number}").body == log.frame(number)
