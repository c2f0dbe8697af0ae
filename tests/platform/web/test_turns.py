"""Requests are worked on in the order of their coming, few at once, and a long one makes room."""

import asyncio

from boresight.platform.web.concurrency_limit import RequestQueue


def test_no_more_have_a_turn_at_once_than_there_are_and_they_come_in_order() -> None:
    async def run() -> tuple[int, list[int]]:
        turns, at_once, most, order = RequestQueue(3, 60.0), 0, 0, list[int]()

        async def work(number: int) -> None:
            nonlocal at_once, most
            async with turns.turn():
                at_once += 1
                most = max(most, at_once)
                order.append(number)
                await asyncio.sleep(0.001)
                at_once -= 1

        await asyncio.gather(*(work(number) for number in range(50)))
        return most, order

    most, order = asyncio.run(run())
    assert most == 3
    assert order == list(range(50))


def test_who_takes_long_makes_room_once_and_gives_no_turn_back_twice() -> None:
    async def run() -> list[str]:
        turns, seen = RequestQueue(1, 0.02), list[str]()

        async def long() -> None:
            async with turns.turn():
                await asyncio.sleep(0.2)
                seen.append("long")

        async def short(number: int) -> None:
            async with turns.turn():
                seen.append(f"short {number}")

        await asyncio.gather(long(), short(1), short(2))
        assert turns._free == 1
        return seen

    assert asyncio.run(run()) == ["short 1", "short 2", "long"]


def test_who_leaves_while_waiting_or_fails_takes_no_turn_along() -> None:
    async def run() -> int:
        turns = RequestQueue(1, 60.0)

        async def work(*, fails: bool = False) -> None:
            async with turns.turn():
                await asyncio.sleep(0.01)
                if fails:
                    raise ValueError

        first = asyncio.create_task(work(fails=True))
        leaving = [asyncio.create_task(work()) for _ in range(5)]
        last = asyncio.create_task(work())
        await asyncio.sleep(0)
        for task in leaving:
            task.cancel()
        await asyncio.gather(first, *leaving, last, return_exceptions=True)
        return turns._free

    assert asyncio.run(run()) == 1


def test_the_next_turn_goes_to_what_was_waited_for_longest_by_all_who_wait() -> None:
    async def run() -> list[str]:
        turns, order = RequestQueue(1, 60.0), list[str]()

        async def work(name: str, waited_s: float | None = None) -> None:
            async with turns.turn(None if waited_s is None else lambda _: waited_s):
                order.append(name)
                await asyncio.sleep(0.01)

        await asyncio.gather(work("at once"), work("alone"), work("for two", 2.0), work("for many", 20.0))
        return order

    assert asyncio.run(run()) == ["at once", "for many", "for two", "alone"]
