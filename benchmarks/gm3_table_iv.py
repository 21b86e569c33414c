"""Table IV of GM3 with every reading of its inputs: python benchmarks/gm3_table_iv.py."""

from diffstack_mmv.dynamics.lagged_truth import VARIANTS, command_profiles, score
from diffstack_mmv.vehicles import load_vehicle


def main() -> None:
    spec = load_vehicle("bicycle")
    chosen = command_profiles()
    print("ADE of GM3 / KBM in m\n")
    print("| inputs | " + " | ".join(chosen) + " |")
    print("|---" * (len(chosen) + 1) + "|")
    for letter, variant in VARIANTS.items():
        scores = [score(spec, profile, variant) for profile in chosen.values()]
        cells = [f"{each.gm3_m:.2f} / {each.kbm_m:.2f}" for each in scores]
        print(f"| {letter}: {variant.told} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
