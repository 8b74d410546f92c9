"""A window and its past: solved, summarised and solved again, and what holds of every window."""

import numpy as np

from .some_windows import NAMES, elsewhere, window, wrapped


def rest_of(some, newest, prior):
    """The window after its past has become a prior."""
    later = some["pose_of"] > newest
    names = ("pose_of", "landmark_of", "z", "R")
    rest = {name: some[name][later] for name in names}
    rest["pose_of"] = rest["pose_of"] - newest
    rest |= {name: some[name][newest:] for name in ("poses", "motions", "Q")}
    return rest | {"landmarks": some["landmarks"], "prior": dict(zip(NAMES, prior, strict=True))}


def put_together(functions, generator):
    """A window solved, its past summarised, and the rest solved again, with first estimates."""
    some = window(generator, poses=5, landmarks=5, known=2)
    at = None
    for _ in range(2):
        at = functions.call("points", some, "fej")
        before = some
        Lam, eta = functions.call("construct", some, *at)
        poses, landmarks = functions.call("solve", some, Lam, eta)
        some = {**some, "poses": np.asarray(poses), "landmarks": np.asarray(landmarks)}
    prior = functions.call("marginalise", before, 2, *at)
    some = rest_of(some, 2, [np.asarray(part) for part in prior])
    Lam, eta = functions.call("construct", some, *functions.call("points", some, "fej"))
    poses, landmarks = functions.call("solve", some, Lam, eta)
    kept, _ = functions.call("schur", np.asarray(Lam), np.asarray(eta), np.arange(3, 6))
    return [poses, landmarks, np.linalg.inv(kept)]


def free(generator, **sizes):
    """A window that nobody told where it is."""
    some = window(generator, known=0, **sizes)
    some["prior"] = {name: np.zeros(3) for name in NAMES} | {"Lam": np.zeros((3, 3))}
    some["prior"]["centre"] = some["prior"]["first"] = some["poses"][0].copy()
    return some


def shaken(generator, some):
    """What new measurements do to the estimates: they move, and the past stays linearised where it was."""
    poses = some["poses"] + generator.normal(size=some["poses"].shape) * [0.2, 0.2, 0.1]
    return {**some, "poses": poses, "landmarks": some["landmarks"] + 0.2 * generator.normal(size=(5, 2))}


def after_the_past(functions, generator, policy):
    """Information matrix of a window that nobody told where it is, once its past has become a prior."""
    some = free(generator, poses=5, landmarks=5)
    prior = functions.call("marginalise", some, 2, *functions.call("points", some, policy))
    some = shaken(generator, rest_of(some, 2, [np.asarray(part) for part in prior]))
    at = functions.call("points", some, policy)
    Lam, _ = functions.call("construct", some, *at)
    return np.asarray(Lam), at


def statements(functions, generator):
    """Marginals of Gaussians, and what nobody can see."""
    some = free(generator, poses=3)
    at = elsewhere(generator, some)
    Lam_free, _ = functions.call("construct", some, *at)
    N = functions.call("world_motions", *at)
    first = functions.call("marginalise", some, 1, *at)
    left = first[3]
    N_left = functions.call("world_motions", left[None, :3], left[3:].reshape(-1, 2))

    fej, fej_at = after_the_past(functions, generator, "fej")
    N_fej = functions.call("world_motions", *fej_at)

    whole = window(generator, poses=4)
    here = whole["poses"], whole["landmarks"]
    Lam, eta = functions.call("construct", whole, *here)
    everything = functions.call("solve", whole, Lam, eta)
    rest = rest_of(whole, 2, functions.call("marginalise", whole, 2, *here))
    Lam_rest, eta_rest = functions.call("construct", rest, whole["poses"][2:], whole["landmarks"])
    poses, landmarks = functions.call("solve", rest, Lam_rest, eta_rest)
    tail = np.arange(6, len(eta))

    turn, shift = 0.7, np.array([3.0, -2.0])
    c, s = np.cos(turn), np.sin(turn)
    away = np.array([[c, -s], [s, c]])
    other = {**some, "poses": some["poses"].copy(), "landmarks": some["landmarks"] @ away.T + shift}
    other["poses"][:, :2] = some["poses"][:, :2] @ away.T + shift
    other["poses"][:, 2] = wrapped(some["poses"][:, 2] + turn)
    prior = {**whole["prior"], "Lam": 20 * np.eye(3), "eta": np.zeros(3), "first": some["poses"][0]}
    answers = []
    for each in (some, other):
        held = {**each, "prior": {**prior, "centre": each["poses"][0]}}
        system = functions.call("construct", held, each["poses"], each["landmarks"])
        answers.append(functions.call("solve", held, *system))
    (poses_1, landmarks_1), (poses_2, landmarks_2) = answers
    return {
        "without a prior, moving or turning the whole world at the points of the Jacobians changes nothing": (
            relative(Lam_free @ N, Lam_free)
        ),
        "what marginalising leaves knows nothing of where the world is": relative(
            first[0] @ N_left, first[0]
        ),
        "with first estimates, a window with a summarised past still does not see the whole world turn": (
            relative(fej @ N_fej, fej)
        ),
        "with the past summarised, the rest of the window takes the step that it takes with it": float(
            max(np.abs(poses - everything[0][2:]).max(), np.abs(landmarks - everything[1]).max())
        ),
        "the rest of the window is as certain with the summary as with the past itself": relative(
            np.linalg.inv(Lam_rest) - np.linalg.inv(Lam)[np.ix_(tail, tail)], np.linalg.inv(Lam_rest)
        ),
        "moving the whole world moves the solution with it": float(
            max(
                np.abs(poses_1[:, :2] @ away.T + shift - poses_2[:, :2]).max(),
                np.abs(wrapped(poses_1[:, 2] + turn - poses_2[:, 2])).max(),
                np.abs(landmarks_1 @ away.T + shift - landmarks_2).max(),
            )
        ),
    }


def relative(matrix, scale):
    return float(np.abs(matrix).max() / np.abs(scale).max())


def heading_from_nothing(functions, generator):
    """Standard deviations' worth of information about the world's heading [1/rad], with the latest estimates.

    Nothing told it: the past was linearised at other values than the present.
    """
    Lam, at = after_the_past(functions, generator, "latest")
    turn = functions.call("world_motions", *at)[:, 2]
    return float(np.sqrt(max(turn @ Lam @ turn, 0.0)))
