"""Numbers of all kinds that formulas calculate with: trees, intervals and discs."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar


class Number(ABC):
    """A number with Python's operators, where floats may stand on the left:

    slope = 1.0 / (1.0 + a**2.0)

    Attributes:
        kind: The name of the function of an operation for numbers of this kind.
    """

    kind: ClassVar[str]

    @abstractmethod
    def like(self, value: float) -> Any:
        """Return a float as a number of the same kind."""

    def __sub__(self, other: Any) -> Any:
        return self + -other  # type: ignore[operator]

    def __truediv__(self, other: Any) -> Any:
        return self * other.reciprocal()  # type: ignore[operator]

    def __radd__(self, value: float) -> Any:
        return self.like(value) + self

    def __rsub__(self, value: float) -> Any:
        return self.like(value) - self

    def __rmul__(self, value: float) -> Any:
        return self.like(value) * self

    def __rtruediv__(self, value: float) -> Any:
        return self.like(value) / self
