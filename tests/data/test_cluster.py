"""`prepare` on a cluster: real ones of two workers, of Ray and of Dask, on this machine."""

import pytest

from riemlayer.data.cluster import connected
from riemlayer.data.dataset import sample_files
from riemlayer.data.prepare import Report, run
from riemlayer.data.run_folder import read_failures

pytestmark = [
    pytest.mark.filterwarnings("ignore::Warning:ray"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # sockets of clusters that are ended
    pytest.mark.filterwarnings("ignore:Exception ignored in"),
    pytest.mark.filterwarnings("ignore:Tip. In future versions of Ray:FutureWarning"),
]


@pytest.fixture(scope="module")
def ray():
    """A cluster of Ray with two workers."""
    ray = pytest.importorskip("ray")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield "ray"
    ray.shutdown()


@pytest.fixture
def dask():
    """A cluster of Dask with two workers."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as local:
        yield local.scheduler_address


def shape(i):
    """A job that makes a small sample (a closure, so that workers need not import this file)."""

    def make():
        import numpy as np

        return {"x": np.random.default_rng(i).normal(size=(50, 3))}, {"seed": str(i)}

    return make


def contents(folder):
    return {f.name: f.read_bytes() for f in sample_files(folder)}


@pytest.mark.slow
def test_ray_gives_the_files_of_this_machine(ray, tmp_path):
    """Also when a job fails, a job kills its process, and a worker of the cluster is killed."""

    def bad():
        raise ValueError("no such shape")

    def dies():
        import os

        os._exit(1)

    def kills(marker=tmp_path / "killed"):
        import os
        import signal

        if not marker.exists():
            marker.touch()
            os.kill(os.getppid(), signal.SIGKILL)  # its worker
        return shape(9)()

    good = {f"s{i}": shape(i) for i in range(3)}
    run(good | {"kills": shape(9)}, tmp_path / "here", workers=2)
    jobs = good | {"bad": bad, "dies": dies, "kills": kills}
    report = run(jobs, tmp_path / "there", 1, seconds=60, cluster=ray)
    assert (tmp_path / "killed").exists()
    assert (report.written, report.failed) == (4, 2)
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    assert read_failures(tmp_path / "there") == {
        "bad": "ValueError: no such shape",
        "dies": "the worker died or took more than 60 s",
    }
    assert run(jobs, tmp_path / "there", 1, cluster=ray) == Report(0, skipped=6, failed=0)


@pytest.mark.slow
def test_a_full_disk_stops_the_run_there_too(ray, tmp_path):
    def large():
        import resource

        import numpy as np

        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
        return {"x": np.zeros(100_000)}, {}

    with pytest.raises(OSError, match="too large"):
        run({"large": large}, tmp_path, 1, cluster=ray)
    assert not list(tmp_path.glob("*.safetensors"))


@pytest.mark.slow
def test_dask_gives_the_files_of_this_machine(dask, tmp_path):
    jobs = {f"s{i}": shape(i) for i in range(3)}
    run(jobs, tmp_path / "here", workers=2)
    assert run(jobs, tmp_path / "there", 1, cluster=dask) == Report(3, skipped=0, failed=0)
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


@pytest.mark.parametrize("address", ["slurm", "http://127.0.0.1:1", ""])
def test_an_address_of_no_known_cluster_is_refused(address):
    known = "cluster must be ray, ray://HOST:PORT or tcp://HOST:PORT"
    with pytest.raises(ValueError, match=known), connected(address):
        pass
