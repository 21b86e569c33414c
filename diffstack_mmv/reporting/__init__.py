"""Tables from saved results; nothing here runs a model."""

from dmmv_conventions.extras import needs

with needs("stack", "diffstack_mmv.reporting"):
    from diffstack_mmv.reporting.ablation_table import ablation_table
    from diffstack_mmv.reporting.bootstrapping import bootstrap
    from diffstack_mmv.reporting.by_excitation import (
        PairedSamples,
        by_excitation,
        paired_samples,
        write_by_excitation,
    )
    from diffstack_mmv.reporting.closed_loop import closed_loop_table, write_closed_loop
    from diffstack_mmv.reporting.compared_runs import read_runs
    from diffstack_mmv.reporting.comparison import Comparison, compare, write_comparison
    from diffstack_mmv.reporting.earlier import require_same_drive, require_same_evaluation
    from diffstack_mmv.reporting.files import (
        read_json,
        read_parquet,
        write_compact,
        write_json,
        write_parquet,
        write_text,
    )
    from diffstack_mmv.reporting.identification import (
        models_table,
        write_identification,
        write_tables,
    )
    from diffstack_mmv.reporting.joint_table import DrivenRow, joint_table, write_joint_table
    from diffstack_mmv.reporting.metrics_table import summarise_modes, write_metrics
    from diffstack_mmv.reporting.paired import (
        paired_cases,
        paired_table,
        paired_with_run,
        require_comparable,
    )
    from diffstack_mmv.reporting.paired_tests import paired_tests, require_score
    from diffstack_mmv.reporting.paper_table import paper_table, write_paper_table
    from diffstack_mmv.reporting.prediction_table import prediction_table
    from diffstack_mmv.reporting.runs import Run
    from diffstack_mmv.reporting.scores import ScoreHeading, Scores
    from diffstack_mmv.reporting.table import markdown_table

__all__ = [
    "ablation_table",
    "Comparison",
    "DrivenRow",
    "PairedSamples",
    "Run",
    "ScoreHeading",
    "Scores",
    "bootstrap",
    "by_excitation",
    "closed_loop_table",
    "compare",
    "joint_table",
    "markdown_table",
    "models_table",
    "paired_cases",
    "paired_samples",
    "paired_table",
    "paired_tests",
    "paired_with_run",
    "paper_table",
    "prediction_table",
    "read_json",
    "read_parquet",
    "read_runs",
    "require_comparable",
    "require_same_drive",
    "require_same_evaluation",
    "require_score",
    "summarise_modes",
    "write_by_excitation",
    "write_closed_loop",
    "write_compact",
    "write_comparison",
    "write_identification",
    "write_tables",
    "write_joint_table",
    "write_json",
    "write_metrics",
    "write_paper_table",
    "write_parquet",
    "write_text",
]
