"""Progress bars for `progress=`.

Any callable will do: `progress(phase, done, total)` is called on the thread that called the
work, with the name of what is done now, the steps that are done, and their number or None. Of a
fit the steps are thousandths of its time.
"""

from __future__ import annotations

from typing import Any

FORMAT = "{percentage:3.0f}%|{bar}| {desc}, {elapsed}, {remaining} left"


class ProgressBar:
    """One tqdm bar for the whole work, in terminals and notebooks; needs the package tqdm.

    >>> images = scene.render(brdf, progress=rig.ProgressBar())  # doctest: +SKIP

    Keywords are those of tqdm.
    """

    def __init__(self, **options: Any) -> None:
        from tqdm.auto import tqdm

        self._tqdm = tqdm
        self._options = {"bar_format": FORMAT, "smoothing": 0.0} | options
        self._bar: Any = None
        self._phase: str | None = None

    def __call__(self, phase: str, done: int, total: int | None) -> None:
        if self._bar is None:
            self._bar = self._tqdm(total=total, **self._options)
        elif total != self._bar.total or done < self._bar.n:
            self._bar.total = total
            self._bar.reset()
        self._bar.update(done - self._bar.n)
        if phase != self._phase or done == total:
            self._phase = phase
            self._bar.set_description_str(phase)

    def close(self) -> None:
        """End the bar; the next work begins another."""
        if self._bar is not None:
            self._bar.close()
        self._bar = self._phase = None

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
