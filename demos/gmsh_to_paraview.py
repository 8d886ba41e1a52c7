# %% [markdown]
# # From gmsh to contact to ParaView
#
# A plate with a hole is drawn with gmsh, rests on the ground with its lower edge, and is written to
# a file that ParaView opens. The names of the sides are given in gmsh and used ever after.

# %%
from pathlib import Path

import dolfinx_signorini as ds

import gmsh
import ufl
from dolfinx import fem
from mpi4py import MPI

comm = MPI.COMM_WORLD

# %% [markdown]
# ## The mesh
#
# Each side is a physical group: a number, with which DOLFINx tags the facets. The model lives on
# rank 0, and `ds.gmsh_mesh` hands the mesh out to all ranks.

# %%
GROUND, TOP, PLATE = 1, 2, 10
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
if comm.rank == 0:
    occ = gmsh.model.occ
    plate = occ.addRectangle(0.0, 0.0, 0.0, 2.0, 1.0)
    occ.cut([(2, plate)], [(2, occ.addDisk(0.7, 0.5, 0.0, 0.2, 0.2))])
    occ.synchronize()
    lines = {line: occ.getCenterOfMass(1, line)[1] for _, line in gmsh.model.getEntities(1)}
    gmsh.model.addPhysicalGroup(1, [k for k, y in lines.items() if y < 1e-6], GROUND)
    gmsh.model.addPhysicalGroup(1, [k for k, y in lines.items() if y > 1.0 - 1e-6], TOP)
    gmsh.model.addPhysicalGroup(2, [s for _, s in gmsh.model.getEntities(2)], PLATE)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.06)
    gmsh.model.mesh.generate(2)
mesh, tags = ds.gmsh_mesh(gmsh.model, comm, 2)
gmsh.finalize()

# %% [markdown]
# ## The problem
#
# The plate conducts better to the right, is held at the top, and is pulled down by a load. The
# contact boundary is given as tags with a value.

# %%
V = fem.functionspace(mesh, ("Lagrange", 1))
u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
a = (1.0 + x[0] ** 2) * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx(degree=4)
L = -2.0 * v * ufl.dx
bc = fem.dirichletbc(0.0, fem.locate_dofs_topological(V, 1, tags.find(TOP)), V)
ground = -0.15 - 0.1 * (x[0] - 1.0) ** 2
problem = ds.SignoriniProblem(a, L, contact=(tags, GROUND), obstacle=ground, bcs=[bc])
problem.solve()
problem.plot(what="solution")

# %%
problem.plot(sides={"ground": tags.find(GROUND)})

# %% [markdown]
# ## The file for ParaView
#
# Solution, gap and pressure live in the same space, so that one VTX file takes all of them. In
# ParaView (5.12.1 or newer): *File, Open* `plate.bp`, reader *ADIOS2 VTX*, *Apply*, and colour by
# `pressure`. An older ParaView needs `VTXWriter(..., engine="BP4")`. Where DOLFINx has no ADIOS2,
# `dolfinx.io.XDMFFile` writes one function after the other.

# %%
from dolfinx.io import VTXWriter

folder = Path("results")
folder.mkdir(exist_ok=True)
with VTXWriter(comm, folder / "plate.bp", [problem.u, problem.gap, problem.pressure]) as file:
    file.write(0.0)
if comm.rank == 0:
    print("written:", *sorted(path.name for path in folder.glob("plate.bp")))

# %% [markdown]
# ## The same without a script
#
# A scene file says all this in twenty lines, `demos/scenes/plate.toml`, and
# `dolfinx-signorini solve plate.toml --outputs fields,pictures` solves it, writes the file for
# ParaView and draws the pictures.
