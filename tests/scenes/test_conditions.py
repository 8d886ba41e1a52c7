"""Boundary conditions: a new kind needs nothing but its class."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.pictures.contact_boundary import gather_contact_boundary
from dolfinx_signorini.scenes import expectations, posing, solve_scene
from dolfinx_signorini.scenes.files import conditions
from dolfinx_signorini.scenes.output.pictures import draw_scene
from dolfinx_signorini.scenes.output.summary import summarise

SPRINGS = """
[domain]
shape = "square"
cells = 6
[contact]
sides = "bottom"
bound = "{bound}"
[[robin]]
sides = "top"
value = {value}
c = 2
[solution]
u = "{sign}y"
norms = ["Linf"]
"""


@dataclass(frozen=True)
class Robin(conditions.BoundaryCondition):
    """Sides with grad u . n = value - c u."""

    c: conditions.Formula
    key = "robin"
    value_key = "value"
    name = "Robin"
    acts_like = "Neumann"
    force_name = "springs"
    style: ClassVar = {"color": "green"}

    @classmethod
    def read(cls, table, domain, manufactured):
        sides, value, c = table.sides(domain.side_names), table.formula("value"), table.formula("c")
        table.finish()
        return cls(sides, value, c)

    def words(self):
        return f"springs {self.on_sides()}"

    def load(self, setting):
        return self.value.ufl(setting.x)

    def coefficient(self, setting):
        return self.c.ufl(setting.x)


@pytest.mark.parametrize(("bound", "sign", "value"), [("lower", "-", -3.0), ("upper", "", 3.0)])
def test_a_new_kind_of_condition_is_one_class(bound, sign, value, comm, parse, monkeypatch):
    kinds = (*conditions.CONDITIONS, Robin)
    for module in (conditions, posing, expectations):
        monkeypatch.setattr(module, "CONDITIONS", kinds)
    scene = parse(SPRINGS.format(bound=bound, sign=sign, value=value))
    assert "springs on top" in expectations.terms(scene)
    result = solve_scene(scene, comm)
    boundary = gather_contact_boundary(result.posed.problem)
    summary = summarise(result, [boundary])
    pictures = draw_scene(result, [boundary], summary.detachment_points)
    result.destroy()
    assert result.expectation.notes == ()  # near corners springs are like any other flux
    assert summary.errors["Linf"] <= 1e-9
    force = np.sign(value)
    wanted = {"springs": force, "contact": -force}
    assert summary.forces == pytest.approx(wanted, abs=1e-9)
    if comm.rank == 0:
        legend = pictures["solution"].legends[0].get_texts()
        assert [text.get_text() for text in legend] == ["contact", "Neumann", "Robin", "in contact"]


def test_without_the_class_the_table_is_unknown(parse):
    with pytest.raises(InputError, match="line 8: robin: unknown key"):
        parse(SPRINGS.format(bound="lower", sign="-", value=1))
