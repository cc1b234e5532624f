"""Read the state of processes from /proc."""

from pathlib import Path


def of_process(pid: int | str, file: str) -> str:
    """Return the content of a process's file in /proc; an empty string if the process has ended."""
    try:
        return Path(f"/proc/{pid}/{file}").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""


def children_of(pid: int) -> list[int]:
    return [int(child) for child in of_process(pid, f"task/{pid}/children").split()]


def is_running(pid: int) -> bool:
    """Return whether a process is running; zombies are not."""
    return of_process(pid, "stat").rpartition(")")[2].split()[:1] not in ([], ["Z"])
