"""Watch over environments in this process, one of which may never answer."""

import _thread
import signal
import threading
import time
import warnings
from types import TracebackType

from astray.world import Silent

LOOKS = 8  # in the time that one environment may take


class Watch:
    """Context in which no environment may take longer than `patience` seconds.

    A thread looks whether `turn` still changes. If it does not, the main thread is interrupted as
    by Ctrl+C, and the context raises RuntimeError instead of KeyboardInterrupt. Another thread, or
    a process that ignores Ctrl+C, cannot be interrupted; it warns.

    Args:
        patience: Seconds.
        who: Environment or environments, as the error calls them.

    Attributes:
        turn: Count of calls of environments, which their owner increments.
    """

    def __init__(self, patience: float, who: str):
        self.turn, self._patience, self._who = 0, patience, who
        self._busy = self._hangs = False
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._is_main = threading.current_thread() is threading.main_thread()
        self._thread = threading.Thread(target=self._look, daemon=True, name="astray-watch")

    def __enter__(self) -> None:
        if self._thread.ident is None:
            self._thread.start()
        self._busy = True

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        with self._lock:
            self._busy = False
        if self._hangs and kind is KeyboardInterrupt:
            self._hangs = False
            raise Silent(f"{self._told()}. World(patience=...) waits longer") from error

    def end(self) -> None:
        """End the thread."""
        self._ended.set()

    def _look(self) -> None:
        last, since = -1, time.monotonic()
        while not self._ended.wait(self._patience / LOOKS):
            with self._lock:
                if not self._busy or self._hangs or self.turn != last:
                    last, since = self.turn, time.monotonic()
                elif time.monotonic() - since > self._patience:
                    self._hangs = True
                    self._interrupt()

    def _interrupt(self) -> None:
        if not self._is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            warnings.warn(f"{self._told()}, and cannot be interrupted here", stacklevel=1)
        elif hasattr(signal, "pthread_kill"):  # a signal of the system also ends a sleep
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        else:
            _thread.interrupt_main()

    def _told(self) -> str:
        return f"{self._who} did not answer for {self._patience:g} s"
