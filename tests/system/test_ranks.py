"""Start of ranks: the option -n, and the output of mpirun that reaches the user."""

from __future__ import annotations

import io

import pytest

from app.command_line.parser import parser
from app.foundation.errors import InputError
from app.system import ranks

RULE = "-" * 74 + "\n"
NON_ZERO = (
    RULE
    + "prterun detected that one or more processes exited with non-zero status,\n"
    + "thus causing the job to be terminated. The first process to do so was:\n\n"
    + "   Process name: [prterun-host-18422@1,0]\n   Exit code:    4\n"
    + RULE
)
CRASH = (
    RULE
    + "prterun noticed that process rank 1 with PID 20251 on node host exited on\n"
    + "signal 11 (Segmentation fault).\n"
    + RULE
)


def test_ranks_option_before_and_after_the_case() -> None:
    for words, n in {"": 1, "-n 2": 2, "-n16": 16, "-n=16": 16, "-n 2 -n3": 3}.items():
        for line in (f"run a-n4 {words}", f"run {words} a-n4"):
            options = parser().parse_args(line.split())
            assert (options.n, str(options.case)) == (n, "a-n4")


@pytest.mark.parametrize("value", ["0", "-1", "two", "1.5", "²", ""])
def test_ranks_wrong_number_is_an_input_error(value: str) -> None:
    for words in (["-n", value], [f"-n={value}"]):
        with pytest.raises(InputError, match=r"not a number of ranks|expected one"):
            parser().parse_args(["run", "case.yaml", *words])


@pytest.mark.parametrize("command", ["check a.yaml", "sweep a.yaml", "report a", "verify"])
def test_ranks_are_an_option_of_run_alone(command: str) -> None:
    for words in ("-n 2", "-n2", "-n=2"):
        with pytest.raises(InputError, match="only mantle run starts ranks, --cores N"):
            parser().parse_args(f"{command} {words}".split())


@pytest.mark.parametrize(
    ("environ", "expected"),
    [
        ({}, None),
        ({"SLURM_JOB_ID": "1", "SLURM_NTASKS": "8"}, None),  # a batch script, not yet a step
        ({"OMPI_COMM_WORLD_SIZE": "4"}, 4),
        ({"PMI_RANK": "0", "PMI_SIZE": "3"}, 3),
        ({"SLURM_STEP_ID": "0", "SLURM_STEP_NUM_TASKS": "2", "SLURM_NTASKS": "8"}, 2),
        ({"PMIX_RANK": "1"}, 0),
    ],
)
def test_ranks_of_an_existing_job_are_recognised(
    environ: dict[str, str], expected: int | None
) -> None:
    assert ranks.world_size(environ) == expected


def test_ranks_keep_the_environment_of_user_and_scheduler() -> None:
    environ = {"OMP_NUM_THREADS": "2", "OMPI_MCA_btl": "tcp,self"}
    assert environ.items() <= ranks.environment(environ).items()
    assert ranks.environment({})["OMP_NUM_THREADS"] == "1"
    assert not ranks.ONE_NODE.keys() & ranks.environment({"SLURM_JOB_ID": "1"}).keys()


def test_ranks_of_one_node_need_no_network() -> None:
    for size, expected in (("2", "self,sm"), ("4", None)):
        environ = {"OMPI_COMM_WORLD_SIZE": size, "OMPI_COMM_WORLD_LOCAL_SIZE": "2"}
        ranks.use_one_node(environ)
        assert environ.get("OMPI_MCA_btl") == expected


TABLE = RULE + "interface   gap\n" + RULE + "\nlast words without an end"
ABORT = (
    RULE
    + "MPI_ABORT was invoked on rank 1 in communicator MPI_COMM_WORLD\n"
    + RULE
    + RULE
    + 'prterun has exited due to process rank 1 with PID 0 on node host calling\n"abort".\n'
    + RULE
    + "\n\0"
)


@pytest.mark.parametrize(
    ("printed", "received", "left"),
    [
        ("step 1\n" + NON_ZERO + "case.yaml:1:2: no\n", (), "step 1\ncase.yaml:1:2: no\n"),
        (CRASH, (), CRASH),
        (CRASH, (2,), ""),
        (TABLE, (), TABLE),
        (RULE, (), RULE),
        ("mantle: internal error\n" + ABORT, (), "mantle: internal error\n"),
        ("[warn] Epoll MOD(4) on fd 22 failed. Old events were 6\n", (), ""),
    ],
    ids=["exit code", "crash", "crash after a signal", "table", "rule", "abort", "closed pipe"],
)
def test_ranks_hide_banners_of_mpirun(printed: str, received: tuple[int, ...], left: str) -> None:
    target = io.BytesIO()
    ranks.filter_messages(io.BytesIO(printed.encode()), target, received)
    assert target.getvalue().decode() == left
