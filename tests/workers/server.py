"""A server in the smallest form, for tests to kill: a dispatcher on the store that the environment names."""

import signal
import threading

from boresight.platform.db.sessions import open_engine
from boresight.settings import read_settings, use_kernel_folder


def main() -> None:
    settings = read_settings()
    use_kernel_folder(settings)
    from standin import Unwarmed  # noqa: PLC0415 - after the kernel folder is set

    from boresight.workers import cluster  # noqa: PLC0415 - likewise
    from boresight.workers.dispatcher import RunDispatcher  # noqa: PLC0415 - likewise

    cluster.WarmUp = Unwarmed
    asked = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: asked.set())
    dispatcher = RunDispatcher(open_engine(settings.database_url), settings, calculation="standin:calculate")
    dispatcher.start()
    asked.wait()
    dispatcher.stop()


if __name__ == "__main__":
    main()
