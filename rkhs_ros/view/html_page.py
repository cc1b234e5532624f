"""Write a run as a self-contained HTML page: its learning curve, and an episode in 3D beside the policy."""

from base64 import b64encode
from contextlib import redirect_stdout
from html import escape
from io import BytesIO, StringIO

from rkhs_ros.base.validation import require
from rkhs_ros.pictures.run_pictures import curve_figure
from rkhs_ros.runs.curve import columns
from rkhs_ros.view.iteration_panel import IterationPanel
from rkhs_ros.view.page import clock, counted
from rkhs_ros.view.recorded import Recorded, state_of
from rkhs_ros.view.serving import opened

ADDRESS, PORT = "127.0.0.1", 8080  # of the server that draws the scene, or the next free port
CURVE_DPI = 110
STYLE = """
body { font-family: sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; }
img { max-width: 100%; }
iframe { width: 100%; height: 620px; border: 1px solid #ccc; }
"""


def html_page(source: Recorded) -> str:
    """Return the page of a run, which needs no other file and no connection.

    Args:
        source: a run with at least one iteration.

    Raises:
        ValueError: the run has no complete iteration.
    """
    source.refresh()
    require(bool(source.rows), f"{source.path}", "a run with at least one complete iteration", "none")
    name, last = escape(source.name), source.rows[-1]
    state = f"{state_of(source).capitalize()}: iteration {last.iteration} of {source.total}"
    counts = f"{counted(last.episodes, 'episode')} in {clock(last.seconds)}"
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{name}</title><style>{STYLE}</style></head><body>
<h1>{name}</h1>
<p>{state}. {counts} on <code>{escape(source.task.environment)}</code>. {_returns(source)}</p>
<h2>Learning curve</h2>
<img alt="Returns per iteration" src="data:image/png;base64,{_curve(source)}">
<h2>An episode of iteration {source.iterations[-1]}</h2>
<p>Drag the bar below the scene to any moment. Drag the scene to turn it.</p>
<iframe title="An episode in 3D, and the policy" srcdoc="{escape(_scene(source))}"></iframe>
</body></html>
"""


def _returns(source: Recorded) -> str:
    """Return the last returns as a sentence."""
    last = source.rows[-1]
    kinds = {
        "exploration": (last.exploration_return, last.undiscounted_exploration_return),
        "evaluation": (last.evaluation_return, last.undiscounted_evaluation_return),
    }
    known = [
        f"{name} {value:.4g}" + f" (undiscounted {total:.4g})" * (total == total and total != value)
        for name, (value, total) in kinds.items()
        if value == value  # not nan
    ]
    return f"Last returns: {', '.join(known)}." if known else ""


def _curve(source: Recorded) -> str:
    """Return the picture of the learning curve, as PNG in base 64."""
    content = BytesIO()
    curve_figure(columns(source.rows), source.task).savefig(content, format="png", dpi=CURVE_DPI, facecolor="white")
    return b64encode(content.getvalue()).decode()


def _scene(source: Recorded) -> str:
    """Return a page that plays an episode of the last iteration in 3D."""
    server = opened(ADDRESS, PORT)
    try:
        recording = server.get_scene_serializer()
        panel = IterationPanel(server, source)
        last = source.iterations[-1]
        view = source.load(last)
        require(view is not None, f"{source.path}", f"the episodes of iteration {last}", "none")
        if view is not None:
            panel.show({last: view})
        panel.play_once(recording.insert_sleep)
        return recording.as_html()
    finally:
        with redirect_stdout(StringIO()):  # viser prints that it stops
            server.stop()
