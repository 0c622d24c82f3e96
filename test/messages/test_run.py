"""The run: time goes on where stamps step back, and begins again where the first sample comes again."""

from tam_calibration.messages.timeline import Run

MS = 1_000_000


def test_time_is_that_of_the_stamps_while_they_rise():
    """A step ahead is kept as a gap."""
    run = Run()
    stamps = [5, 10 * MS, 20 * MS, 10**18]
    assert [run.time_ns(stamp) for stamp in stamps] == stamps


def test_time_goes_on_where_stamps_step_back():
    """After each step it goes on by the shortest interval, and all later stamps keep their distances."""
    run = Run()
    stamps = [0, 20 * MS, 30 * MS, 10 * MS, 15 * MS, -500 * MS, -400 * MS]
    times = [0, 20 * MS, 30 * MS, 40 * MS, 45 * MS, 50 * MS, 150 * MS]
    assert [run.time_ns(stamp) for stamp in stamps] == times


def test_a_run_begins_again_with_its_first_sample():
    """Stamp and readings must be the same: a clock that is set back to the first stamp begins no run."""
    run = Run()
    assert [run.begins_again(*sample) for sample in [(5, "a"), (6, "b"), (5, "c"), (5, "a")]] == [False] * 3 + [True]
    assert run.time_ns(5) == 5
    run.start_over()
    assert not run.begins_again(5, "a")


def test_a_recording_that_is_played_again_keeps_its_times():
    """Each round has the times of the first."""
    run, rounds = Run(), []
    for _ in range(3):
        for stamp in (10 * MS, 20 * MS, 30 * MS):
            run.begins_again(stamp, stamp)
            rounds.append(run.time_ns(stamp))
    assert rounds == [10 * MS, 20 * MS, 30 * MS] * 3
