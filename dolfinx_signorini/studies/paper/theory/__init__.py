"""The analysis of Christof and Haubner as experiments: what the paper states, computed.

The computations work on a `Discretisation` of an `Example`:

    examples          known solutions of chosen regularity
    triangulations    meshes beside those of Friedrichs and Keller
    discretisation    an example on one mesh, with integrals that are consistent with each other
    curve             the boundary of the domain as a closed curve of mesh edges
    mixed             problem (3), and problems without known solution
    ritz              Definition 3.1, Lemmas 3.2 and 3.3, Theorem 3.6
    one_sided         Lemma 3.5 and problem (11), and the infimum of Lemma 3.4
    contact_sets      condition (A_h)
    dual              Section 5: Lemmas 5.2 and 5.6, Propositions 5.4 and 5.7
    proven            Corollaries 4.1 and 4.2, Theorems 4.3 and 6.1, and the constants of Remark 4.4
    parts             parts of the error, by sign and by place, and the discrete W^{2,p} seminorm
    enclosures        where contact begins, enclosed

The command runs them over families of meshes and tells the results:

    measures          what a row holds
    families          the families of meshes, and their rows on disk
    checks            a figure beside what is proven, and the rule that says whether they agree
    statements        the list of statements, with their checks as `data/statements.toml` has them
    figures           pictures
    report            the document
"""
