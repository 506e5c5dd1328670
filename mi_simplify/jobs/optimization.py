"""
Any glTF file, fitted in place to any images: parameters by name, a step at a time.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..config import Config, load_config
from ..config.problems import nearest
from ..errors import AssetError, ConfigError, UserError
from ..export.environment import write_environment
from ..export.in_place import check_in_place, write_in_place
from ..fitting import Run
from ..formats.load import load_asset
from ..judging.normal_maps import FIGURE, TrueNormals
from ..latent.file_model import FileModel, file_model
from ..machine.runtime import ensure_variant
from ..model.frame import Frame
from ..model.light.environment_map import as_map
from ..model.light.harmonics import constant_environment
from ..model.model import Model
from ..record.output import check_writable
from ..scenes.views import Views
from .targets import Target, open_target

log = logging.getLogger("mi_simplify")

#: What can be optimised, by the name that people give it: the quantity of the fit, and the key of its rate.
PARAMETERS: dict[str, tuple[str, str]] = {
    "positions": ("vertices", "vertices"),
    "base_color": ("base_color", "base_color"),
    "opacity": ("opacity", "opacity"),
    "roughness": ("roughness", "roughness"),
    "metallic": ("metallic", "metallic"),
    "normal": ("normal", "normal"),
    "environment": ("ambient", "ambient"),
    "weights": ("weights", "weights"),
}

#: Where the defaults differ from those of a simplification: nothing is a first guess here, so steps are larger.
DEFAULTS: dict[str, Any] = {
    "optimizer": {
        "steps": 1000,
        "tolerance": 0.0,
        "spp": 4,
        "rates": {"vertices": 0.005, "base_color": 0.01, "specular": 0.01, "normal": 0.01},
        "large_steps": {"lambda_": 1.0},
    },
    "reference": {"spp": 16},
    "latent": {"ambient": {"kind": "none", "color": (0.05, 0.05, 0.05)}},
    "loss": {"laplacian": {"weight": 0.05}},
}


class Optimization:
    """
    The optimisation of a glTF file towards what it should look like; everything that is not named stays as it is.

    Adam with a rate for each name. Topology, texture coordinates, nodes, materials and all else of the file stay;
    several meshes and materials are optimised at once, and a mesh that several nodes place is one.

    Parameters
    ----------
    initial : str or Path
        A GLB or glTF file.
    targets : str, Path, Asset or callable
        ``transforms.json``, an image, a model, or a function of views: see :func:`.targets.open_target`. Images are in
        the units and the place of ``initial``.
    steps : int, optional
        Over which the rates fall.
    resolution : int, optional
        Side of the images [pixels]; 256, or that of the targets where these are smaller.
    batch : int, optional
        Views of a step; 8, or as many as there are.
    views : int or Views, optional
        Of a model or a function: how many views are looked at, always the same, or which (in the units of the file);
        None: new ones all the time.
    camera : int or str
        Of an image: number or name of the file's camera that saw it.
    texture_size : int
        Side of textures that a material has not had [texels].
    overrides : iterable of str or mapping
        Settings as of :func:`..config.load_config`.

    Raises
    ------
    UserError
        The file, the targets or a setting cannot be used.

    Examples
    --------
    >>> opt = ms.Optimization("initial.glb", targets="images/transforms.json")
    >>> opt.requires_grad("positions", normal=0.02)
    >>> for _ in range(1000):
    ...     opt.step()
    >>> opt.save("optimized.glb")
    """

    def __init__(
        self,
        initial: str | Path,
        targets: Any,
        *,
        steps: int | None = None,
        resolution: int | None = None,
        batch: int | None = None,
        views: int | Views | None = None,
        camera: int | str = 0,
        texture_size: int = 512,
        overrides: Any = (),
    ):
        path = Path(initial)
        if path.suffix.lower() not in (".glb", ".gltf"):
            raise AssetError(f"what is fitted in place is a GLB or glTF file, got '{path.name}'; export it as one")
        if texture_size < 1 or texture_size > 8192:
            raise ConfigError(f"texture_size: a side between 1 and 8192 texels is needed, got {texture_size}")
        given = {"steps": steps, "resolution": resolution, "batch": batch}
        stated: dict[str, Any] = {"optimizer": {key: value for key, value in given.items() if value is not None}}
        config = load_config(None, [DEFAULTS, {"asset": str(path)}, *overrides, stated])
        config = config.model_copy(update={"variant": ensure_variant(config.variant)})
        self.asset = load_asset(path)
        self.frame = Frame.around(self.asset.bounds)
        self.target: Target = open_target(targets, self.asset, self.frame, config, views=views, camera=camera)
        self.config = _fitting(config, self.target, resolution is None, batch is None)
        self._texture_size, self._rates = texture_size, dict[str, float | None]()
        self._run: Run | None = None
        self._origin: FileModel | None = None
        self._truth: TrueNormals | None = None
        self.notes = [*_unused(self.asset.notes), *self.target.notes]

    def requires_grad(self, *names: str, **rates: float | None) -> None:
        """
        Name what is optimised, before the first step.

        Parameters
        ----------
        names : str
            Of :data:`PARAMETERS`.
        rates : float, optional
            More of them, each with its rate: the typical step, in halves of the model's size for positions. None: that
            of the settings.

        Raises
        ------
        ConfigError
            A name is unknown, lists those that are known; or a rate is no positive number.
        UserError
            A step was done.
        """
        if self._run is not None:
            raise UserError("what is optimised is named before the first step; begin another Optimization")
        for name, rate in {**dict.fromkeys(names), **rates}.items():
            if name not in PARAMETERS:
                known = ", ".join(PARAMETERS)
                raise ConfigError(f"'{name}' is no parameter{nearest(name, PARAMETERS)}; known are {known}")
            if rate is not None and not rate > 0:
                raise ConfigError(f"the rate of '{name}' should be above 0, got {rate}")
            self._rates[name] = rate

    @property
    def names(self) -> tuple[str, ...]:
        """What is optimised."""
        return tuple(self._rates)

    def prepare(self) -> tuple[Model, Config]:
        """
        The model to begin with, in the normalised frame, and the settings of its fit.

        Raises
        ------
        UserError
            Nothing was named, or the file cannot take what was.
        """
        if not self._rates:
            raise ConfigError(f"nothing is to be optimised; name some of {', '.join(PARAMETERS)}")
        quantities = [PARAMETERS[name][0] for name in self._rates]
        if self._origin is None:
            self.notes += check_in_place(self.asset.source, self.asset.parts, quantities)
            origin = file_model(self.frame.normalised(self.asset), quantities, self._texture_size)
            if "opacity" in quantities and origin.model.alpha_mode == "OPAQUE":
                raise ConfigError(f"'opacity': no material of {self.asset.name} is transparent; leave it out")
            if "weights" in quantities and origin.model.morphs is None:
                raise ConfigError(f"'weights': no mesh of {self.asset.name} has morph targets; leave it out")
            self.notes += origin.notes
            self._origin = origin
            self._truth = None if self.target.asset is None else TrueNormals.of(self.target.asset, self.asset)
            for note in dict.fromkeys(self.notes):
                log.warning("%s: %s", self.asset.name, note)
        ambient = self.target.ambient
        if ambient is None and "ambient" in quantities:
            ambient = constant_environment(self.config.latent.ambient.color)
        if ambient is not None and len(ambient) > 1 and (rows := self.config.latent.ambient.rows):
            ambient = as_map(ambient, rows)
        return replace(self._origin.model, ambient=ambient), _optimizing(self.config, self._rates)

    def step(self) -> dict | None:
        """
        One step: render, compare, differentiate, Adam.

        Returns
        -------
        dict or None
            Of every tenth step, and those after which the state is judged, ``step`` and ``loss``; of the latter also
            ``psnr`` [dB], and ``normal_dissimilarity`` where there is any.
        """
        return self.run.step()

    @property
    def run(self) -> Run:
        """The fit under way; begun at its first use."""
        if self._run is None:
            model, settings = self.prepare()
            self._run = Run(model, self.target.reference, settings, measure=self.measure)
        return self._run

    @property
    def measure(self) -> Callable[[Model], dict[str, float]] | None:
        """
        ``normal_dissimilarity`` of a model of this fit, where the target is a model with a normal map in the same
        texture coordinates; None where it is not, or before :meth:`prepare`.
        """
        truth, origin = self._truth, self._origin
        if truth is None or origin is None:
            return None
        return lambda model: {FIGURE: truth.dissimilarity(origin.normals(model))}

    def model(self) -> Model:
        """
        The best model so far, in the normalised frame.
        """
        run = self.run
        run.judge()
        if run.best_step == 0:
            return run.first_guess
        now = run.fit.parameters()
        run.fit.take(run.best)
        best = run.fit.model()
        if run.best_step != run.done:
            run.fit.take(now)
        return best

    def save(self, path: str | Path) -> Path:
        """
        Write the best state so far: the initial file with what was optimised in it, as GLB.

        Raises
        ------
        OutputError
            It cannot be written.
        ConfigError
            The name does not end with ``.glb``.
        """
        if Path(path).suffix.lower() != ".glb":
            raise ConfigError(f"the result is a GLB file; call it something.glb, got '{Path(path).name}'")
        check_writable(path)
        return self.write(self.model(), path)

    def save_environment(self, path: str | Path) -> Path:
        """
        Write the light of the best state so far as a latitude-longitude image, ``.exr`` or ``.hdr``.

        Raises
        ------
        ConfigError
            The fit has no environment, or the name ends otherwise.
        OutputError
            It cannot be written.
        """
        ambient = self.model().ambient
        if ambient is None or len(ambient) == 1:
            raise ConfigError("this fit has no environment; name 'environment' as one of the parameters")
        check_writable(path)
        return write_environment(ambient, path)

    def write(self, model: Model, path: str | Path) -> Path:
        """
        Write a model of this fit, in the normalised frame.
        """
        if self._origin is None:
            self.prepare()
        assert self._origin is not None
        return write_in_place(self.asset.source, path, self._origin, model, self._quantities())

    def _quantities(self) -> list[str]:
        return [PARAMETERS[name][0] for name in self._rates]


def _fitting(config: Config, target: Target, any_resolution: bool, any_batch: bool) -> Config:
    """The settings with what the number and size of the target's images say."""
    optimizer: dict[str, Any] = {}
    reference: dict[str, Any] = {}
    if any_resolution and target.side is not None:
        side = max(8, min(max(config.optimizer.resolution), -(-target.side // 4) * 4))
        optimizer["resolution"] = (side,)
    if target.n_views is not None:
        reference = {"pool": target.n_views, "refresh": 0}
        if any_batch:
            optimizer["batch"] = min(config.optimizer.batch, target.n_views)
    return config.model_copy(
        update={
            "optimizer": config.optimizer.model_copy(update=optimizer),
            "reference": config.reference.model_copy(update=reference),
        }
    )


def _optimizing(config: Config, rates: Mapping[str, float | None]) -> Config:
    """The settings in which these parameters are optimised at these rates."""
    quantities = tuple(PARAMETERS[name][0] for name in rates if name != "environment")
    ambient = config.latent.ambient.model_copy(update={"optimize": "environment" in rates})
    stated = {PARAMETERS[name][1]: rate for name, rate in rates.items() if rate is not None}
    optimizer = config.optimizer
    optimizer = optimizer.model_copy(update={"rates": optimizer.rates.model_copy(update=stated)})
    latent = config.latent.model_copy(update={"optimize": quantities, "ambient": ambient})
    return config.model_copy(update={"latent": latent, "optimizer": optimizer})


def _unused(notes: tuple[str, ...]) -> list[str]:
    """Notes of the reader without those on what stays in the file."""
    kept = ("cameras were left out", "lights were left out", "animations were left out", "are carried over")
    return [note for note in notes if not any(text in note for text in kept)]
