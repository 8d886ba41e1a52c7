"""The analysis of Christof and Haubner as experiments: what the paper states, computed.

What is computed stands on the problems: known solutions (`examples`) and others (`mixed`), on one
mesh (`discretisation`, `boundary`), and on what the proofs use: the Ritz projection and `errors`,
`one_sided` approximation, `dual` problems, `enclosures`. What is proven is in `proven`.

An experiment runs `measures` over a family of meshes (`families`). A statement of the paper is an
entry of `data/statements.toml`: what the paper claims, and `checks` of the rows of experiments.
`figures` and `report` tell the results.
"""
