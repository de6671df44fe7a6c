"""Progress bars for `progress=`.

Any callable will do: `progress(phase, done, total)` is called on the thread that called the
work, with the phase's name, the steps that are done, and their number or None.
"""

from __future__ import annotations

from typing import Any


class ProgressBar:
    """A tqdm bar for each phase, in terminals and notebooks; needs the package tqdm.

    >>> images = scene.render(brdf, progress=rig.ProgressBar())  # doctest: +SKIP

    Keywords are those of tqdm.
    """

    def __init__(self, **options: Any) -> None:
        from tqdm.auto import tqdm

        self._tqdm = tqdm
        self._options = options
        self._bar: Any = None
        self._phase: str | None = None

    def __call__(self, phase: str, done: int, total: int | None) -> None:
        if phase != self._phase or done == 0:
            self.close()
            self._phase = phase
            self._bar = self._tqdm(desc=phase, total=total, **self._options)
        self._bar.update(done - self._bar.n)
        if done == total:
            self.close()

    def close(self) -> None:
        """End the bar of the current phase."""
        if self._bar is not None:
            self._bar.close()
        self._bar = self._phase = None

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
