import os

import pytest

from mvsam.experiments.loaders import num_workers, share_of_scenes


@pytest.mark.parametrize("count", [1, 2, 3, 7, 8])
@pytest.mark.parametrize("processes", [1, 2, 3, 8])
def test_processes_look_at_every_scene_in_equally_many_turns(count: int, processes: int):
    shares = [share_of_scenes(count, process, processes) for process in range(processes)]
    assert {scene for share in shares for scene in share} == set(range(count))
    assert len({len(share) for share in shares}) == 1
    assert all(len(set(share)) == len(share) for share in shares)
    assert sum(map(len, shares)) < count + processes


def test_data_workers_take_the_cores_that_the_trainings_leave(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(16)), raising=False)
    assert num_workers(None, processes=1) == 15
    assert num_workers(None, processes=4) == 3
    assert num_workers(0, processes=4) == 0
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    assert num_workers(None, processes=1) == 1
