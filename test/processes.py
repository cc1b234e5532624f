"""What the system says of processes."""

from pathlib import Path


def of_process(pid: int | str, file: str) -> str:
    """Return what a file of /proc says of a process; nothing where it has ended."""
    try:
        return Path(f"/proc/{pid}/{file}").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""


def children_of(pid: int) -> list[int]:
    """Return the process numbers of a process's children."""
    return [int(child) for child in of_process(pid, f"task/{pid}/children").split()]


def is_running(pid: int) -> bool:
    """Return whether a process has not ended, whoever is to take note of that."""
    return of_process(pid, "stat").rpartition(")")[2].split()[:1] not in ([], ["Z"])
