"""Filter browser messages: accept only the updates that the page's controls can send."""

from __future__ import annotations

import logging
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from viser import ViserServer

FOREIGN = 1008  # close code of a web socket: policy violation
UPDATE = "GuiUpdateMessage"  # sent by controls
SILENT = ("websockets.server", "asyncio")  # loggers that would report each malformed message


def guard(server: ViserServer, *, local: bool) -> None:
    """Make a viser server ignore all messages except updates that its controls can send.

    Browsers cannot upload files or request a public address. Connections from pages of other origins are closed.
    viser has no public hook for messages or for the headers of a connection.

    Args:
        server: server to protect.
        local: whether it serves this machine only; connections that use another host name are then closed, too.
    """
    for name in SILENT:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    sockets: Any = server._websock_server
    controls, handle = server.gui._gui_input_handle_from_uuid, sockets._handle_incoming_message
    rejected: set[int] = set()  # messages sent before the disconnection may still arrive

    async def checked(client_id: int, message: Any) -> None:
        control = controls.get(message.uuid) if type(message).__name__ == UPDATE else None
        if client_id not in rejected and control is not None and is_fitting(control, message.updates):
            await handle(client_id, message)

    sockets._handle_incoming_message = checked

    @sockets.on_client_connect  # type: ignore[untyped-decorator]
    async def _(client: Any) -> None:
        connection = sockets._live_connections[client.client_id]
        if not is_allowed(connection.request.headers, local=local):
            rejected.add(client.client_id)
            await connection.close(FOREIGN, "from another page")


def is_allowed(headers: Any, *, local: bool) -> bool:
    """Return whether a web socket has the origin of this page and, if local, a local host name."""
    host, origin = headers.get("Host", ""), headers.get("Origin")
    return (origin is None or urlsplit(origin).netloc == host) and (
        not local or is_local(urlsplit(f"//{host}").hostname)
    )


def is_local(host: str | None) -> bool:
    """Return whether a host name or address is local to this machine."""
    try:
        return host == "localhost" or ip_address(host or "").is_loopback
    except ValueError:
        return False


def is_fitting(control: Any, updates: Any) -> bool:
    """Return whether a user could make this update with the control."""
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
