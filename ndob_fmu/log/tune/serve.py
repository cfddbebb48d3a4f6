"""The page on the loopback address: no other machine reaches it."""

from __future__ import annotations

import logging
import socket
from pathlib import Path

from werkzeug.serving import BaseWSGIServer, make_server

from ndob_fmu.log.tune.page import page
from ndob_fmu.log.tune.workbench import Workbench

HOST, USUAL_PORT = "127.0.0.1", 8050


def page_server(workbench: Workbench, title: str, folder: Path) -> BaseWSGIServer:
    """Return the server of the page, which listens already; at another free port where the usual one is taken."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    port = USUAL_PORT if _is_free(USUAL_PORT) else 0
    return make_server(HOST, port, page(workbench, title, folder).server, threaded=True)


def address(server: BaseWSGIServer) -> str:
    """Return where the page is."""
    return f"http://{HOST}:{server.server_port}/"


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind((HOST, port))
        except OSError:
            return False
    return True
