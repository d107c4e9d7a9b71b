"""`nolens studio`."""

import signal
from pathlib import Path
from typing import Annotated

from nolens.cli.app import Whole
from nolens.cli.messages import say, show

_FOLDER = Path("nolens-studio")


def studio(
    *folders: Path,
    port: Annotated[int | None, Whole] = None,
    host: str = "127.0.0.1",
    browser: bool = True,
    camera: str = "auto",
) -> int:
    """Open a page on which to see through a camera, design it, calibrate it and take pictures.

    nolens studio

    nolens studio bench --camera raspberry

    Without a camera a simulated one is looked through. Ctrl-C ends it.

    Parameters
    ----------
    folders
        The first is where pictures, cameras and uploads are kept, made when something is first
        written. The page can read files in all of them, and nowhere else.
        [default: nolens-studio]
    port
        Of the page; 0 takes any that is free.  [default: 8350, or the next that is free]
    host
        Address to serve on. Beyond this computer, such as 0.0.0.0, the page asks for a token,
        which the address that is shown has in it.
    browser
        Open the page in the browser.
    camera
        auto, raspberry, twin, twin:CAMERA (a preset, or a folder with camera.toml), or
        folder:PATH for a folder that another camera writes raw files into. auto is the Raspberry
        Pi's camera where there is one, or else the twin.
    """
    # The command's help need not load the server.
    from nolens.studio.app import Studio
    from nolens.studio.serve import Served, listen, serve, workspace_of

    paths = [path.expanduser() for path in folders or (_FOLDER,)]
    workspace, source = workspace_of(paths, camera)
    listening = listen(host, port, say)

    def started(served: Served) -> None:
        show(served.url)
        say(f"files are kept in {workspace.work}; Ctrl-C ends the studio")

    # The server heeds Ctrl-C, and hands it on when all of it has ended.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        serve(
            Studio(workspace, host=host, source=source, say=say),
            listening,
            browser=browser,
            started=started,
        )
    except KeyboardInterrupt:
        say("the studio has ended")
        return 130
    return 0
