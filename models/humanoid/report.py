"""The comparison as text and as JSON."""

from __future__ import annotations

from .limits import PROFILES, Comparison, StudyRow, mean_estimate
from .params import params
from .trial import Trial

__all__ = ["figures", "study_figures", "study_table", "table"]


def table(found: Comparison) -> str:
    """Limits and trials as text.

    Parameters
    ----------
    found : Comparison
    """
    rules, humanoid = params().trial, found.humanoid
    lines = [
        f"{humanoid.mass:.1f} kg humanoid of dm_control, motors at {humanoid.gears:g} times its torques; a constant "
        "lateral force on the right hand,",
        f"sudden or rising over {rules.rise:g} s, trials of {found.duration:g} s, {humanoid.friction} friction cones, "
        f"velocity noise {found.noise:g}; y: across the body, -y: away from it",
        "",
        f"largest force held with {len(rules.test_seeds)} seeds of the noise, no foot sliding more than "
        f"{100.0 * rules.slide:g} cm, in N (in steps of "
        f"{rules.resolution:g}, largest tried {found.schedules[next(iter(found.schedules))].forces[-1]:g})",
        f"{'stance':<10}{'tips at':>10}"
        + "".join(f"{p + ', ' + m:>20}" for p in PROFILES for m in ("LQR", "PhyFilter")),
        f"{'':<10}{'y':>5}{'-y':>5}" + f"{'y':>15}{'-y':>5}" * 4,
    ]
    for name in found.schedules:
        cells = "".join(f"{each:>5.0f}" for each in found.tipping[name])
        for profile in PROFILES:
            for mode in ("alone", "filter"):
                pair = [found.limit(name, profile, direction, mode) for direction in (1.0, -1.0)]
                cells += (
                    f"{_force(pair[0].force, pair[0].capped):>15}{_force(pair[1].force, pair[1].capped):>5}"
                )
        lines.append(f"{name:<10}{cells}")
    lines += [
        "",
        "tips at: static limit of the upright posture taken as rigid, centre of pressure at the edge of the feet.",
        "Beyond it a slow force is held by leaning; a sudden one would need a step, and this robot takes none.",
        "Single trials: first seed; slide: of the foot that slid most. Pyramidal cones creep under a steady force.",
    ]
    if found.trials:
        lines += [
            "",
            f"{'stance':<10}{'force':>10}{'profile':>10}{'LQR':>16}{'PhyFilter':>16}{'estimate':>12}{'slide':>10}",
        ]
    for name, profile, force, mode in found.trials:
        if mode == "filter":
            trial, alone = (
                found.trials[name, profile, force, mode],
                found.trials[name, profile, force, "alone"],
            )
            fates = f"{_fate(alone):>16}{_fate(trial):>16}{mean_estimate(trial):>10.1f} N{100.0 * trial.slide:>7.1f} cm"
            lines.append(f"{name:<10}{force:>8g} N{profile:>10}{fates}")
    return "\n".join(lines)


def _force(force: float, capped: bool) -> str:
    return f"{'>=' if capped else ''}{force:.0f}"


def _fate(trial: Trial) -> str:
    if not trial.stood:
        return f"falls at {trial.time[-1]:.1f} s"
    return "held" if trial.held else f"slides {100.0 * trial.slide:.0f} cm"


def figures(found: Comparison) -> dict[str, object]:
    """The same, for JSON.

    Parameters
    ----------
    found : Comparison
    """
    return {
        "mass_kg": found.humanoid.mass,
        "gears": found.humanoid.gears,
        "friction": found.humanoid.friction,
        "velocity_noise": found.noise,
        "seeds": list(params().trial.test_seeds),
        "duration_s": found.duration,
        "filter": {"a": found.filter.a.tolist(), "b": found.filter.b.tolist()},
        "tipping_n": {name: {"y": pair[0], "-y": pair[1]} for name, pair in found.tipping.items()},
        "largest_held_n": [
            {
                "stance": each.stance,
                "profile": each.profile,
                "direction": "y" if each.direction > 0.0 else "-y",
                "mode": each.mode,
                "force": each.force,
                "largest_tried": each.capped,
            }
            for each in found.limits
        ],
        "trials": [
            {
                "stance": name,
                "profile": profile,
                "force_n": force,
                "mode": mode,
                "held": trial.held,
                "stood": trial.stood,
                "end_s": float(trial.time[-1]),
                "estimate_n": mean_estimate(trial) if mode == "filter" else None,
                "slide_m": trial.slide,
            }
            for (name, profile, force, mode), trial in found.trials.items()
        ],
    }


def study_table(stance: str, rows: tuple[StudyRow, ...]) -> str:
    """The study as text.

    Parameters
    ----------
    stance : str
    rows : tuple of StudyRow
    """
    seeds = len(params().trial.tuning_seeds)
    lines = [
        f"{stance} stance: largest lateral hand force held with {seeds} seeds, N; "
        f"velocity noise {params().sensors.velocity_noise:g} where none is given",
        f"{'':<44}{'sudden y':>10}{'-y':>6}{'slow y':>10}{'-y':>6}",
    ]
    lines += [
        f"{r.name:<44}{r.sudden[0]:>10.0f}{r.sudden[1]:>6.0f}{r.slow[0]:>10.0f}{r.slow[1]:>6.0f}"
        for r in rows
    ]
    return "\n".join(lines)


def study_figures(stance: str, rows: tuple[StudyRow, ...]) -> dict[str, object]:
    """The same, for JSON.

    Parameters
    ----------
    stance : str
    rows : tuple of StudyRow
    """
    return {
        "stance": stance,
        "rows": [{"name": r.name, "sudden_n": list(r.sudden), "slow_n": list(r.slow)} for r in rows],
    }
