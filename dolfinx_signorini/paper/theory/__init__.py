"""The analysis of Christof and Haubner as experiments: what the paper proves, computed.

The computations work on a `Discretisation` of an `Example`:

    examples        known solutions of chosen regularity
    discretisation  an example on one mesh, with integrals that are consistent with each other
    curve           the boundary of the domain as a closed curve of mesh edges
    ritz            Definition 3.1, Lemmas 3.2 and 3.3, Theorem 3.6
    one_sided       Lemmas 3.4 and 3.5
    contact_sets    conditions (A) and (A_h); violations: sets that violate (A)
    dual            Section 5: Lemmas 5.2 and 5.6, Propositions 5.4 and 5.7
    proven          Corollaries 4.1 and 4.2, Theorems 4.3 and 6.1
    parts           parts of the error: by sign, near the detachment point and away from there

The command runs them over families of meshes and tells the results:

    experiments     the families, and their rows on disk
    evidence        a figure beside what is proven; tables
    section3, section4, section5
                    the checks and tables of each statement
    statements      the list of statements
    figures         pictures
    report          the document
"""
