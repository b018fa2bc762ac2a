# mypy: ignore-errors
# This script runs with the libraries of another system.
"""Monado with a configuration, and a client that draws positions as colours; saves the content of Monado's window.

Runs in the Debian that `prepare.sh` makes: `python3 session.py CONFIGURATION RESULT`. The result, .npz, has the screen,
and the views that the client got.
"""

import contextlib
import ctypes
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, "/opt/client")
import moderngl
import numpy as np
import xr

SIZE = 1024
"""Width and height of each eye's picture, pixels."""
EYE_CODES = 64, 192
"""Blue codes of the left and the right eye's picture."""
STEREO = xr.ViewConfigurationType.PRIMARY_STEREO
SRGB8_ALPHA8 = 0x8C43  # codes pass unchanged
PATIENCE_S = 120


def main(configuration, result):
    """Run Monado, show the pictures, save the screen."""
    folder = Path(tempfile.mkdtemp())
    with contextlib.ExitStack() as running:
        screen = ["Xvfb", "-displayfd", "1", "-screen", "0", "3200x1700x24", "-fbdir", str(folder)]
        display = f":{start(running, screen, folder, stdout=subprocess.PIPE).stdout.readline().decode().strip()}"
        os.environ |= {
            "XDG_RUNTIME_DIR": str(folder),
            "XR_RUNTIME_JSON": "/usr/share/openxr/1/openxr_monado.json",
            "IPC_IGNORE_VERSION": "1",  # Debian's client library and the service built here have different versions
        }
        (service,) = Path("/opt/monado").glob("monado-*/build/src/xrt/targets/service/monado-service")
        settings = {
            "NS_CONFIG_PATH": configuration,
            "NS_LOG": "info",
            "XRT_NO_STDIN": "1",
            "XRT_COMPOSITOR_FORCE_XCB": "1",
        }
        start(running, [str(service)], folder, env=os.environ | settings | {"DISPLAY": display})
        log = folder / service.name
        wait_for((folder / "monado_comp_ipc").exists, log)
        wait_for(lambda: "Using Moshi's meshgrid" in log.read_text(errors="replace"), log)
        views, shown = Client().show(lambda: screenshot(folder / "Xvfb_screen0"), log)
        fov = [[v.fov.angle_left, v.fov.angle_right, v.fov.angle_up, v.fov.angle_down] for v in views]
        poses = [[*v.pose.position, *v.pose.orientation] for v in views]
        np.savez(result, screen=shown, fov=fov, poses=poses)


def start(running, command, folder, **settings):
    """Start a program that is terminated with `running`; its output goes to a file with its name."""
    log = (folder / Path(command[0]).name).open("wb")
    settings = {"stdout": log, "stderr": log, "stdin": subprocess.DEVNULL} | settings
    process = subprocess.Popen(command, **settings)
    running.callback(lambda: (process.terminate(), process.wait(20)))
    return process


def wait_for(condition, log):
    """Wait until a condition on Monado holds; exit with Monado's log after `PATIENCE_S`."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            raise SystemExit(f"Monado takes more than {PATIENCE_S} s:\n{log.read_text(errors='replace')}")
        time.sleep(0.1)


def screenshot(file):
    """Return a 24-bit screen as RGB (height, width, 3), from the XWD file of Xvfb."""
    content = file.read_bytes()
    header = np.frombuffer(content[:100], ">u4")
    width, height, line, colours = (int(header[k]) for k in (4, 5, 12, 19))
    pixels = np.frombuffer(content, np.uint8, height * line, int(header[0]) + 12 * colours)
    return pixels.reshape(height, -1, 4)[:, :width, 2::-1].copy()


class Client:
    """An OpenXR session with pictures in which red and green grow with the position in the eye's field of view."""

    def __init__(self):
        self.context = moderngl.create_context(standalone=True, backend="egl")
        about = xr.ApplicationInfo("positions", 1, "wlr_render", 1, xr.Version(1, 0, 34))
        wanted = ["XR_MNDX_egl_enable", "XR_KHR_opengl_enable"]
        self.instance = xr.create_instance(
            xr.InstanceCreateInfo(application_info=about, enabled_extension_names=wanted)
        )
        system = xr.get_system(self.instance, xr.SystemGetInfo(xr.FormFactor.HEAD_MOUNTED_DISPLAY))
        xr.get_opengl_graphics_requirements_khr(self.instance, system)  # OpenXR requires this call
        self.binding = egl_binding()
        chained = ctypes.cast(ctypes.pointer(self.binding), ctypes.c_void_p)
        self.session = xr.create_session(self.instance, xr.SessionCreateInfo(system_id=system, next=chained))
        # VIEW space, so that the runtime's timewarp changes nothing.
        self.space = xr.create_reference_space(self.session, xr.ReferenceSpaceCreateInfo(xr.ReferenceSpaceType.VIEW))
        usage = xr.SwapchainUsageFlags.COLOR_ATTACHMENT_BIT | xr.SwapchainUsageFlags.SAMPLED_BIT
        sizes = {"width": SIZE, "height": SIZE, "face_count": 1, "array_size": 1, "mip_count": 1, "sample_count": 1}
        created = xr.SwapchainCreateInfo(usage_flags=usage, format=SRGB8_ALPHA8, **sizes)
        self.chains = [xr.create_swapchain(self.session, created) for _ in EYE_CODES]
        self.textures = [self._textures(chain) for chain in self.chains]

    def _textures(self, chain):
        images = xr.enumerate_swapchain_images(chain, xr.SwapchainImageOpenGLKHR)
        return [self.context.external_texture(each.image, (SIZE, SIZE), 4, 0, "f1") for each in images]

    def show(self, look, log):
        """Submit frames until the screen shows both eyes and no longer changes; return the views and the screen."""
        deadline, last = time.monotonic() + PATIENCE_S, None
        self._begin(deadline)
        for number in range(10_000):
            views = self._frame(draws=number < 6)
            if number % 10 == 9:
                shown = look()
                both = all((shown[..., 2] == code).any() for code in EYE_CODES)
                if both and last is not None and (shown == last).all():
                    return views, shown
                last = shown
            if time.monotonic() > deadline:
                raise SystemExit(f"Monado's window shows nothing that lasts:\n{log.read_text(errors='replace')}")

    def _begin(self, deadline):
        while time.monotonic() < deadline:
            try:
                event = xr.poll_event(self.instance)
            except xr.EventUnavailable:
                time.sleep(0.01)
                continue
            if event.type == xr.StructureType.EVENT_DATA_SESSION_STATE_CHANGED.value:
                kind = ctypes.POINTER(xr.EventDataSessionStateChanged)
                if ctypes.cast(ctypes.byref(event), kind).contents.state == xr.SessionState.READY.value:
                    xr.begin_session(self.session, xr.SessionBeginInfo(STEREO))
                    return
        raise SystemExit("Monado did not become ready.")

    def _frame(self, draws):
        at = xr.wait_frame(self.session).predicted_display_time
        xr.begin_frame(self.session)
        _, views = xr.locate_views(self.session, xr.ViewLocateInfo(STEREO, at, self.space))
        whole, shown = xr.Rect2Di(xr.Offset2Di(0, 0), xr.Extent2Di(SIZE, SIZE)), []
        for view, chain, textures, code in zip(views, self.chains, self.textures, EYE_CODES, strict=True):
            index = xr.acquire_swapchain_image(chain, xr.SwapchainImageAcquireInfo())
            xr.wait_swapchain_image(chain, xr.SwapchainImageWaitInfo(timeout=xr.INFINITE_DURATION))
            if draws:
                textures[index].write(positions(code).tobytes())
                self.context.finish()
            xr.release_swapchain_image(chain, xr.SwapchainImageReleaseInfo())
            image = xr.SwapchainSubImage(swapchain=chain, image_rect=whole, image_array_index=0)
            shown.append(xr.CompositionLayerProjectionView(pose=view.pose, fov=view.fov, sub_image=image))
        projected = (xr.CompositionLayerProjectionView * len(shown))(*shown)
        layer = xr.CompositionLayerProjection(space=self.space, views=projected)
        opaque = xr.EnvironmentBlendMode.OPAQUE
        xr.end_frame(self.session, xr.FrameEndInfo(at, opaque, layers=[ctypes.byref(layer)]))
        return views


def positions(blue):
    """Return codes (SIZE, SIZE, 4): red from the left border, green from the top; OpenGL's first row is the bottom."""
    along = np.rint((np.arange(SIZE) + 0.5) / SIZE * 255).astype(np.uint8)
    picture = np.full((SIZE, SIZE, 4), 255, np.uint8)
    picture[..., 0], picture[..., 1], picture[..., 2] = along, along[::-1, None], blue
    return picture


def egl_binding():
    """Return the graphics binding of this thread's EGL context, which needs no window."""
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetCurrentDisplay.restype = egl.eglGetCurrentContext.restype = ctypes.c_void_p
    display, context = (ctypes.c_void_p(get()) for get in (egl.eglGetCurrentDisplay, egl.eglGetCurrentContext))
    number, config, found = ctypes.c_int(), ctypes.c_void_p(), ctypes.c_int()
    config_id, none = 0x3028, 0x3038
    egl.eglQueryContext(display, context, config_id, ctypes.byref(number))
    wanted = (ctypes.c_int * 3)(config_id, number.value, none)
    egl.eglChooseConfig(display, wanted, ctypes.byref(config), 1, ctypes.byref(found))
    values = {"get_proc_address": egl.eglGetProcAddress, "display": display, "config": config, "context": context}
    kinds = dict(xr.GraphicsBindingEGLMNDX._fields_)
    return xr.GraphicsBindingEGLMNDX(**{name: ctypes.cast(value, kinds[name]) for name, value in values.items()})


if __name__ == "__main__":
    main(*sys.argv[1:])
