"""Access to view and to touch; viewers never slow the run."""

import asyncio
import json
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace

import can
import numpy as np
import pytest
from aiohttp import WSCloseCode, WSMsgType, WSServerHandshakeError
from aiohttp.test_utils import TestClient, TestServer

from can_rig.buses.bus import open_bus
from can_rig.errors import RigError
from can_rig.panel.live import HOLD
from can_rig.panel.screen import MOST_KEPT, MOST_NEWS, Screen, Viewer, batch, save
from can_rig.panel.server import Access, Server
from can_rig.panel.session import Session
from can_rig.scenario.loading import load
from tests.helpers import record

TOUCH, LOOK = "t" * 32, "l" * 32


@asynccontextmanager
async def served(sends: bool = True):
    """A panel on a bus of its own, and its client."""
    session = Session("virtual:panel", load("ideal"), "ideal", (), sends)
    screen = Screen(session, ["ideal"], None)
    server = TestServer(Server(screen, Access(1, TOUCH, LOOK)).application())
    client = TestClient(server)
    await client.start_server()
    yield client
    await client.close()


@pytest.fixture
def run(monkeypatch):
    """Run a test that is given the client, and headers of a page of the panel's own."""

    def go(test, sends=True):
        async def whole():
            async with served(sends) as client:
                own = f"127.0.0.1:{client.port}"
                monkeypatch.setattr(Access, "is_own_host", lambda self, host: host == own)
                monkeypatch.setattr(
                    Access, "is_own_origin", lambda self, origin: origin == f"http://{own}"
                )
                await asyncio.wait_for(test(client, {"Origin": f"http://{own}"}), 30)

        asyncio.run(whole())

    return go


def test_names_and_origins_are_exact():
    access = Access(8000)
    assert access.is_own_host("127.0.0.1:8000")
    assert access.is_own_origin("http://localhost:8000")
    for host in ("127.0.0.1", "127.0.0.1:80", "evil.example:8000", "127.0.0.1:8000.evil", None):
        assert not access.is_own_host(host)
    for origin in ("https://127.0.0.1:8000", "null", "http://evil.example:8000", "", None):
        assert not access.is_own_origin(origin)
    assert Access(80).is_own_host("127.0.0.1")
    assert Access(80).is_own_origin("http://localhost")
    assert access.may_touch(access.control) is True
    assert access.may_touch(access.view) is False
    assert access.may_touch(access.view + "x") is None
    assert access.may_touch("ä") is None
    assert access.control != Access(8000).control


def test_the_page_and_its_parts_need_a_token(run):
    async def test(client, _own):
        for name in ("", "panel.js", "charts.js", "scene.js", "bench.css", "uplot.js", "uplot.css"):
            answer = await client.get(f"/{LOOK}/{name}")
            assert answer.status == 200
            assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
            assert answer.headers["Referrer-Policy"] == "no-referrer"
            assert (await client.get(f"/{'x' * 32}/{name}")).status == 403
        assert (await client.get("/")).status in (403, 404)
        assert (await client.get(f"/{TOUCH}/../server.py")).status in (403, 404)

    run(test)


def test_another_page_or_another_name_of_this_machine_gets_nothing(run):
    async def test(client, own):
        page = f"/{TOUCH}/"
        assert (await client.get(page, headers={"Host": "evil.example"})).status == 403
        assert (await client.get(page, headers={"Origin": "http://evil.example"})).status == 403
        for headers in ({}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
            with pytest.raises(WSServerHandshakeError):
                await client.ws_connect(f"{page}socket", headers=headers)
        await (await client.ws_connect(f"{page}socket", headers=own)).close()

    run(test)


async def refusal(client, own, token: str, order: str) -> str:
    """Why a panel does not do what the page asks for."""
    socket = await client.ws_connect(f"/{token}/socket", headers=own)
    await socket.send_str(order)
    async for message in socket:
        said = json.loads(message.data)
        if "refused" in said:
            await socket.close()
            return said["refused"]
    return "closed"


@pytest.mark.parametrize(
    ("token", "order", "why"),
    [(LOOK, '{"order": "stop"}', "this address may look only"),
     (TOUCH, '{"order": "clear"}', "the plant node obeys no commands"),
     (TOUCH, '{"order": "choose", "scenario": "/etc/passwd"}', "must be one of the list"),
     (TOUCH, '{"order": "save", "name": "../x"}', "no run has ended yet"),
     (TOUCH, '{"order": "inject", "kind": "x", "place": "torque"}', "not an order"),
     (TOUCH, '{"order": "pace", "value": "fast"}', "not an order"),
     (TOUCH, '{"order": "pace", "value": 1' + 400 * "0" + "}", "not an order"),
     (TOUCH, '{"order": "clear", "place": "x"}', "not an order"),
     (TOUCH, '{"order": "step", "ticks": 1.5}', "must be a whole number of ticks"),
     (TOUCH, 2000 * "[", "not an order"), (TOUCH, '{"order": "_socket"}', "not an order"),
     (TOUCH, "[]", "not an order"), (TOUCH, "{", "not an order")],
)  # fmt: skip
def test_what_cannot_be_done_is_refused_in_a_line(run, token, order, why):
    async def test(client, own):
        assert why in await refusal(client, own, token, order)

    run(test)


def test_who_only_listens_sends_nothing(run):
    async def test(client, own):
        assert "may look only" in await refusal(client, own, TOUCH, '{"order": "clear"}')

    run(test, sends=False)


def test_beside_nodes_of_others_no_run_is_started():
    screen = Screen(SimpleNamespace(running=False), [], None)
    with pytest.raises(RigError, match="it starts none beside them"):
        asyncio.run(screen.obey({"order": "start"}))


def test_a_server_that_ends_says_so_to_who_looks(run):
    async def test(client, own):
        async with client.ws_connect(f"/{LOOK}/socket", headers=own) as socket:
            ends = asyncio.create_task(client.server.close())
            while (message := await socket.receive(5)).type is not WSMsgType.CLOSE:
                pass
            assert message.data == WSCloseCode.GOING_AWAY
            await asyncio.wait_for(ends, 5)

    run(test)


class Browser:
    """The end of a socket in a browser, which takes messages while it is not busy."""

    closed = False

    def __init__(self):
        self.is_free, self.received = asyncio.Event(), []

    async def send_bytes(self, message):
        await self.is_free.wait()
        self.received.append(message)

    send_str = send_bytes

    async def close(self, code):
        self.closed = True


def test_a_browser_that_takes_nothing_loses_the_oldest_rows_and_no_event():
    async def test():
        browser = Browser()
        viewer = Viewer(browser, may_touch=False)
        sending = asyncio.create_task(viewer.send_on())
        rows = [b"%d" % number for number in range(10 * MOST_NEWS)]
        events = [f"event {number}" for number in range(MOST_NEWS // 2)]
        for number, row in enumerate(rows):
            if number % 20 == 1:
                viewer.offer(events[number // 20])  # never waits
            viewer.offer(row, may_drop=True)
            await asyncio.sleep(0)
        browser.is_free.set()
        while rows[-1] not in browser.received:
            await asyncio.sleep(0)
        sending.cancel()
        assert [each for each in browser.received if each in events] == events
        kept = [each for each in browser.received if each in rows]
        assert kept[0] == rows[0]  # was on its way
        assert kept[1:] == rows[len(rows) - len(kept) + 1 :]
        assert len(kept) == MOST_NEWS + 1

    asyncio.run(test())


def test_a_browser_for_which_too_much_waits_is_given_up():
    async def test():
        browser = Browser()
        viewer = Viewer(browser, may_touch=False)
        sending = asyncio.create_task(viewer.send_on())
        for number in range(10 * MOST_KEPT):
            viewer.offer(f"event {number}")
        browser.is_free.set()
        await asyncio.wait_for(sending, 10)
        assert browser.closed
        assert len(browser.received) <= 1

    asyncio.run(test())


def test_a_browser_gets_events_once_and_one_that_comes_late_gets_them_all(tmp_path):
    log, _, scenario = record(tmp_path, "duration_s=0.3", "fault.at_s=0.2", name="ideal")

    async def test():
        session = Session("virtual:events", scenario, "ideal")
        screen = Screen(session, [], None)

        async def looking(*, late):
            """What a browser receives, of which the first is the setup of the page."""
            browser = Browser()
            browser.is_free.set()
            viewer = Viewer(browser, may_touch=False)
            screen.welcome(viewer)
            sending = asyncio.create_task(viewer.send_on())
            if not late:
                for frame in can.LogReader(log):
                    session.live.frames.on_message_received(frame)
            for _ in range(2 * HOLD):
                screen.update()
                await asyncio.sleep(0.001)
            sending.cancel()
            hello, *later = browser.received
            told = [json.loads(each) for each in later if isinstance(each, str)]
            rows = [each for each in later if isinstance(each, bytes)]
            return json.loads(hello)["hello"]["events"], told, rows

        none, told, rows = await looking(late=False)
        events = [event for each in told for event in each.get("events", [])]
        assert none == []
        assert any("fault state: confirmed" in event["text"] for event in events)
        assert [each for each in told if "lamps" in each]
        assert rows
        all_of_them, told, _ = await looking(late=True)
        assert all_of_them == events
        assert not [each for each in told if "events" in each]
        screen.show(session)
        assert (await looking(late=True))[0] == []
        session.close()

    asyncio.run(test())


def test_a_batch_is_counts_and_columns():
    rows = np.arange(6.0).reshape(2, 3)
    data = batch(rows)
    assert np.frombuffer(data, "<u4", 2).tolist() == [2, 3]
    assert np.frombuffer(data, "<f8", offset=8).reshape(3, 2).T.tolist() == rows.tolist()


def test_a_second_start_shows_from_tick_0(tmp_path, monkeypatch):
    """The first run was stopped half-way, the second is heard from its first frame on."""
    log, _, scenario = record(tmp_path, "duration_s=0.05", name="ideal")
    frames = list(can.LogReader(log))

    async def no_process(*_words, **_options):
        return None

    monkeypatch.setattr(asyncio, "create_subprocess_exec", no_process)

    async def test():
        session = Session("virtual:twice", scenario, "ideal")
        with open_bus("virtual:twice") as nodes:
            for heard in (frames[: len(frames) // 2], frames):
                await session.start()
                for frame in heard:
                    nodes.send(frame)
                shown = []
                deadline = asyncio.get_running_loop().time() + 20
                while not shown and asyncio.get_running_loop().time() < deadline:
                    await asyncio.sleep(0.02)
                    shown += session.live.update().tolist()
                assert shown[0][0] == 0.0
        session.close()

    asyncio.run(test())


def test_starts_at_once_are_one_run_and_a_start_waits_for_the_last_run_s_end(monkeypatch):
    begun, noted = [], []

    async def process(*_words, **_options):
        await asyncio.sleep(0.01)
        begun.append(SimpleNamespace(returncode=None))
        return begun[-1]

    async def ended(session):
        while session._process.returncode is None:
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.1)
        noted.append(len(begun))

    monkeypatch.setattr(asyncio, "create_subprocess_exec", process)
    monkeypatch.setattr(Session, "ended", ended)

    async def test():
        screen = Screen(Session("virtual:starts", load("ideal"), "ideal"), [], None)
        await asyncio.gather(screen.start(), screen.start())
        assert len(begun) == 1
        begun[0].returncode = 0
        await screen.start()
        assert (noted, len(begun)) == ([1], 2)
        begun[1].returncode = 0
        await screen.close()

    asyncio.run(test())


@pytest.mark.parametrize("there", ["mine.toml", "mine.csv"])
def test_a_file_that_is_there_is_not_replaced_and_nothing_is_left_beside_it(tmp_path, there):
    Path(there).write_text("mine")
    with pytest.raises(RigError, match=f"{there}: exists already"):
        save(SimpleNamespace(running=False, folder=str(tmp_path / "run")), "mine")
    assert [path.name for path in Path().iterdir()] == [there]
