"""The writers that a channel remembers."""

from __future__ import annotations

from stampede_rt_channel_host.channels.puts.writers import WRITERS_MAX, Writers


def test_the_latest_writer_is_listed_first_with_the_time_of_its_last_put() -> None:
    writers = Writers()
    for name, now in (("a", 1), ("b", 2), ("a", 3)):
        writers.note(name, now)
    assert writers.latest() == [("a", 3), ("b", 2)]


def test_beyond_the_limit_the_writer_with_the_oldest_put_is_forgotten() -> None:
    writers = Writers()
    for number in range(WRITERS_MAX):
        writers.note(f"w{number}", number)
    writers.note("w0", 100)
    writers.note("new", 101)
    names = [name for name, _ in writers.latest()]
    assert names[:2] == ["new", "w0"]
    assert "w1" not in names
    assert len(names) == WRITERS_MAX
