"""Examples for the help of the verbs. tests/test_cli_help.py parses each of them."""

EXAMPLES = {
    "prepare": (
        "prepare --particles 1024 --pressure 1e-3 --seed 1 -o packing.h5",
        "prepare --particles 256,1024 --pressure 1e-2:1e-4:5 --seeds 1:20 -o packings",
    ),
    "info": ("info packing.h5", "info packings --json"),
    "import": ("import other.txt -o packing.h5",),
    "export": ("export packing.h5 --to gsd", "export results.h5 -o results.csv", "export runs -o flow.parquet"),
    "moduli": (
        "moduli packing.h5 --omega 1e-6:1e2:61 -o moduli.h5",
        "moduli packings --beta 0.01,0.1,1 -o moduli.h5 --resume",
    ),
    "nonaffine": ("nonaffine packings -o nonaffine.h5",),
    "modes": ("modes packing.h5 --count 50 -o modes.h5",),
    "density": ("density packings -o density.h5",),
    "correlations": ("correlations packings --omega 1e-4,1 -o correlations.h5",),
    "nonlinear-drag": ("nonlinear-drag packing.h5 --stress 1e-4 -o drag.h5",),
    "oscillate": ("oscillate packing.h5 --amplitude 1e-3,1e-2 --omega 0.01:1:5 -o oscillations.h5",),
    "step-strain": ("step-strain packing.h5 --step 1e-3,1e-2 --time 1:1e3:13 -o steps.h5",),
    "viscosity": ("viscosity packings --beta 0.1 -o viscosity.h5",),
    "aqs": ("aqs packing.h5 --strain 0.1 --step 1e-3 -o path.h5",),
    "shear": (
        "shear --model CD_rot --particles 1024 --phi 0.82 --rate 1e-4 --strain 10 -o run.h5",
        "shear --start packing.h5 --rate 1e-4,1e-3,1e-2 --strain 10 --particles 1024 --phi 0.84 --rescale -o runs",
        "shear --particles 1024 --phi 0.86 --oscillate 0.01:0.1:5 -o oscillation.h5",
    ),
    "ramp": ("ramp --particles 1024 --phi 0.82 --rate 1e-6 --to 1e-3 -o ramp.h5",),
    "figure": ("figure bt3 --preset small",),
    "plot": ("plot moduli.h5 -o moduli.pdf", "plot run.h5 --maps -o maps.png"),
    "report": ("report moduli.h5 -o moduli.html", "report runs -o runs.html"),
}
