"""What a browser may say to the page: move what is there to be moved, and press what is there to be pressed."""

from __future__ import annotations

import logging
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from viser import ViserServer

FOREIGN = 1008  # code of a closed web socket: against the rules
UPDATE = "GuiUpdateMessage"  # what a control sends
SILENT = ("websockets.server", "asyncio")  # loggers that would tell of each piece of garbage


def guard(server: ViserServer, *, local: bool) -> None:
    """Make a viser server ignore every message that no control of the page can send.

    Browsers cannot send files to it or ask for a public address. Pages of other origins, which a browser on this
    machine may have open, are disconnected. viser has no public hook for messages or for the headers of a connection.

    Args:
        server: the server.
        local: whether it serves this machine only; a browser that uses another host name was misled.
    """
    for name in SILENT:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    sockets: Any = server._websock_server
    controls, handle = server.gui._gui_input_handle_from_uuid, sockets._handle_incoming_message
    strangers: set[int] = set()  # what they sent before they were disconnected may still arrive

    async def checked(client_id: int, message: Any) -> None:
        control = controls.get(message.uuid) if type(message).__name__ == UPDATE else None
        if client_id not in strangers and control is not None and is_fitting(control, message.updates):
            await handle(client_id, message)

    sockets._handle_incoming_message = checked

    @sockets.on_client_connect  # type: ignore[untyped-decorator]
    async def _(client: Any) -> None:
        connection = sockets._live_connections[client.client_id]
        if not is_allowed(connection.request.headers, local=local):
            strangers.add(client.client_id)
            await connection.close(FOREIGN, "from another page")


def is_allowed(headers: Any, *, local: bool) -> bool:
    """Return whether a web socket is from our page, not from one of another origin, or of another name for us."""
    host, origin = headers.get("Host", ""), headers.get("Origin")
    return (origin is None or urlsplit(origin).netloc == host) and (
        not local or is_local(urlsplit(f"//{host}").hostname)
    )


def is_local(host: str | None) -> bool:
    """Return whether a name or an address is that of this machine to itself."""
    try:
        return host == "localhost" or ip_address(host or "").is_loopback
    except ValueError:
        return False


def is_fitting(control: Any, updates: Any) -> bool:
    """Return whether an update is one that somebody at the control can make."""
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return False
    value, now = updates["value"], control.value
    if control.disabled or isinstance(value, bool) != isinstance(now, bool):
        return False
    if isinstance(now, bool):
        return True
    if isinstance(now, str):
        return value in getattr(control, "options", ())
    return isinstance(value, int | float) and control.min <= value <= control.max
