"""Faults of the person at the keyboard as one line, in the words of the console script."""

import typer

from gensp.errors import GenSPError

# The library speaks to whoever runs the pipeline; here its remedies are other ones.
_REMEDIES = {
    # What holds another remedy comes before it.
    ", or raise max_faces": " (gensp repair --remesh does)",
    ", or set recipe.fit.own=1": "",
    ", or raise recipe.prepare.solid.largest_distance": "",
    "; start stiffer with recipe.correspond.registration.schedule": "; leave out --register",
    "or pass what gensp.load(MODEL) returns": "or give a trained model with --model",
    "the model.pt of stage=finetune or initialize": "a model.pt that holds both",
    "run python train.py stage=finetune": "train one, or leave out --model",
    "name another folder with paths.runs=FOLDER": "name another place",
    "write it again with stage=parameterize": "write it with gensp parameterize",
}


def fault_line(error: Exception) -> str | None:
    """One line for a fault of the input, None for what is ours."""
    if isinstance(error, typer.TyperException):  # all that the parser of the words complains of
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "gensp"
        said = error.format_message().strip().rstrip(".").replace("\n", " ")
        return f"{command}: {said}; see {command} --help"
    if not isinstance(error, GenSPError):
        return None
    line = " ".join(str(error).split())
    for hydra, ours in _REMEDIES.items():
        line = line.replace(hydra, ours)
    return f"gensp: {line}"
