"""Frames for the head and the eyes that an OpenXR runtime tracks.

    python 10_openxr.py              poses of a headless session (XR_MND_headless); this program drives the panels
    python 10_openxr.py swap-chain   composes into the runtime's swap chain (XR_MNDX_egl_enable); needs no window

Writes the poses that the runtime locates to recording.jsonl; draw them again with `wlr-render render --head
recording.jsonl --eye-track recording.jsonl`.

Needs the extra `xr` and a running OpenXR runtime: docs/openxr.md has one with a simulated headset.
"""

import ctypes
import json
import sys
import time
from pathlib import Path

import moderngl
import numpy as np

import wlr_render as wlr
from wlr_render.engine import DepthKind, TextureLayer, eye_motion, script_needs
from wlr_render.files import write_png
from wlr_render.geometry import normalised, transforms

with script_needs("xr"):
    import xr

SIZE, FRAMES, NEAR_M, FIXATION_M = (360, 400), 20, 0.05, 1.0
TO_FIRST_ROW_NS, SCAN_OUT_NS = 15_000_000, 8_000_000
POSITION_AND_ORIENTATION_VALID = 3
ANDROID, EXT, FB = "XR_ANDROID_eye_tracking", "XR_EXT_eye_gaze_interaction", "XR_FB_eye_tracking_social"
STEREO = xr.ViewConfigurationType.PRIMARY_STEREO
SWAP_CHAIN = sys.argv[1:] == ["swap-chain"]

# The headset. Its optics are known in the device frame, where the runtime's VIEW space is this far from the origin.
models = {eye: wlr.open_eye("northstar", eye) for eye in ("left", "right")}  # or your model.json
device_from_view = transforms.rigid(np.eye(3), np.mean([each.eye_box.centre for each in models.values()], axis=0))

# The engine: cubes on a grid, drawn with its own shader.
VERTEX = """
#version 410
uniform mat4 clip_from_world;
out vec3 place;
void main() {
    vec3 corner = vec3(gl_VertexID & 1, gl_VertexID >> 1 & 1, gl_VertexID >> 2) - 0.5;
    place = 0.3 * vec3(gl_InstanceID % 7 - 3, gl_InstanceID / 7 % 5 - 2, -2 - gl_InstanceID / 35) + 0.1 * corner;
    gl_Position = clip_from_world * vec4(place, 1);
}"""
FRAGMENT = """
#version 410
in vec3 place;
out vec4 colour;
void main() { colour = vec4(step(0.5, fract(place * 20 + 0.25)) * 0.7 + 0.3, 1); }"""
CUBE = [0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5]
ctx = moderngl.create_context(standalone=True, backend="egl", require=410)
program = ctx.program(VERTEX, FRAGMENT)
cubes = ctx.vertex_array(program, [], index_buffer=ctx.buffer(np.array(CUBE, np.uint32)))
compositor = wlr.Compositor(models, SIZE, context=ctx)
pictures = {
    eye: ctx.framebuffer([ctx.texture(camera.size_px, 4)], ctx.depth_texture(camera.size_px))
    for eye, camera in compositor.begin_frame(np.eye(4), {e: m.eye_box.centre for e, m in models.items()}).items()
}
compositor.prepare()  # else the first frames compile shaders, and the recording has gaps there
ctx.enable(moderngl.DEPTH_TEST)


def draw_and_submit(cameras):
    for eye, camera in cameras.items():
        pictures[eye].use()
        pictures[eye].clear()
        clip_from_world = camera.projection(NEAR_M) @ camera.camera_from_world
        program["clip_from_world"].write(np.ascontiguousarray(clip_from_world.T, np.float32))
        cubes.render(instances=105)
    compositor.submit(pictures, stored=wlr.StoredDepth(DepthKind.WINDOW, NEAR_M, np.inf))


def egl_binding():
    """The graphics binding of this thread's EGL context, which needs no window."""
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


def rigid(pose):
    """Matrix (4, 4) of an XrPosef; normalises its float32 quaternion."""
    return transforms.rigid(transforms.rotation_of_quaternion(list(pose.orientation)), np.array(list(pose.position)))


class Runtime:
    """An OpenXR session with its head, eye and gaze tracking."""

    def __init__(self):
        wanted = ["XR_MNDX_egl_enable", "XR_KHR_opengl_enable"] if SWAP_CHAIN else ["XR_MND_headless"]
        offered = {each.extension_name.decode() for each in xr.enumerate_instance_extension_properties()}
        if missing := set(wanted) - offered:
            raise SystemExit(f"the OpenXR runtime does not offer {', '.join(sorted(missing))}; Monado does.")
        wanted += {"XR_KHR_convert_timespec_time", ANDROID, EXT, FB} & offered
        about = xr.ApplicationInfo("wlr_render example", 1, "wlr_render", 1, xr.Version(1, 0, 34))
        self.instance = xr.create_instance(
            xr.InstanceCreateInfo(application_info=about, enabled_extension_names=wanted)
        )
        self.name = xr.get_instance_properties(self.instance).runtime_name.decode()
        system = xr.get_system(self.instance, xr.SystemGetInfo(xr.FormFactor.HEAD_MOUNTED_DISPLAY))
        binding = None
        if SWAP_CHAIN:
            xr.get_opengl_graphics_requirements_khr(self.instance, system)  # OpenXR demands the call
            self._binding = egl_binding()
            binding = ctypes.cast(ctypes.pointer(self._binding), ctypes.c_void_p)
        self.session = xr.create_session(self.instance, xr.SessionCreateInfo(system_id=system, next=binding))
        self.world, self.view = (
            xr.create_reference_space(self.session, xr.ReferenceSpaceCreateInfo(each))
            for each in (xr.ReferenceSpaceType.LOCAL, xr.ReferenceSpaceType.VIEW)
        )
        self._last_pose = np.eye(4)
        self.eye_tracking, self._tracker = None, None
        for name, make in ((ANDROID, self._pupil_tracker), (EXT, self._gaze_action), (FB, self._gaze_tracker)):
            if self._tracker is None and name in wanted:
                self.eye_tracking, self._tracker = name, make(system)
        if self._tracker is None:
            self.eye_tracking = None
        self._begin()

    def _has(self, system, eye_tracking):
        """Return a structure of the system's properties, filled by the runtime."""
        chained = ctypes.cast(ctypes.pointer(eye_tracking), ctypes.c_void_p)
        properties = xr.SystemProperties(next=chained)
        xr.raw_functions.xrGetSystemProperties(self.instance, system, ctypes.byref(properties))
        return eye_tracking

    def _pupil_tracker(self, system):
        has = self._has(system, xr.SystemEyeTrackingPropertiesANDROID())
        return xr.create_eye_tracker_android(self.session) if has.supports_eye_tracking else None

    def _gaze_tracker(self, system):
        has = self._has(system, xr.SystemEyeTrackingPropertiesFB())
        return xr.create_eye_tracker_fb(self.session) if has.supports_eye_tracking else None

    def _gaze_action(self, system):
        """Return action set, action and space of the gaze, or None if the headset has no eye tracker."""
        if not self._has(system, xr.SystemEyeGazeInteractionPropertiesEXT()).supports_eye_gaze_interaction:
            return None
        actions = xr.create_action_set(self.instance, xr.ActionSetCreateInfo("gaze", "gaze", 0))
        made = xr.ActionCreateInfo(
            action_name="gaze", action_type=xr.ActionType.POSE_INPUT, localized_action_name="gaze"
        )
        action = xr.create_action(actions, made)
        path = xr.string_to_path(self.instance, "/user/eyes_ext/input/gaze_ext/pose")
        profile = xr.string_to_path(self.instance, "/interaction_profiles/ext/eye_gaze_interaction")
        suggested = (xr.ActionSuggestedBinding * 1)(xr.ActionSuggestedBinding(action, path))
        xr.suggest_interaction_profile_bindings(
            self.instance,
            xr.InteractionProfileSuggestedBinding(interaction_profile=profile, suggested_bindings=suggested),
        )
        space = xr.create_action_space(self.session, xr.ActionSpaceCreateInfo(action=action))
        attached = xr.SessionActionSetsAttachInfo(action_sets=(xr.ActionSet * 1)(actions))
        xr.attach_session_action_sets(self.session, attached)
        return actions, action, space

    def _begin(self):
        """Begin the session when the runtime is ready."""
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline:
            try:
                event = xr.poll_event(self.instance)
            except xr.EventUnavailable:
                time.sleep(0.01)
                continue
            if event.type == xr.StructureType.EVENT_DATA_SESSION_STATE_CHANGED.value:
                kind = ctypes.POINTER(xr.EventDataSessionStateChanged)
                changed = ctypes.cast(ctypes.byref(event), kind).contents
                if changed.state == xr.SessionState.READY.value:
                    xr.begin_session(self.session, xr.SessionBeginInfo(STEREO))
                    return
        raise SystemExit("the OpenXR runtime did not become ready within 20 s.")

    def now(self):
        """Now, in the runtime's nanoseconds."""
        convert = xr.get_instance_proc_addr(self.instance, "xrConvertTimespecTimeToTimeKHR")
        seconds, nanoseconds = divmod(time.clock_gettime_ns(time.CLOCK_MONOTONIC), 1_000_000_000)
        converted = xr.Time()
        signature = ctypes.CFUNCTYPE(ctypes.c_int, xr.Instance, ctypes.c_void_p, ctypes.POINTER(xr.Time))
        timespec = (ctypes.c_long * 2)(seconds, nanoseconds)
        if ctypes.cast(convert, signature)(self.instance, ctypes.addressof(timespec), converted) != 0:
            raise SystemExit("the OpenXR runtime cannot convert times.")
        return converted.value

    def head_pose(self, at):
        """world_from_device as the runtime predicts it for a time; the last good one while the head is not tracked."""
        located = xr.locate_space(self.view, self.world, at)
        valid = located.location_flags & POSITION_AND_ORIENTATION_VALID == POSITION_AND_ORIENTATION_VALID
        if valid:
            self._last_pose = rigid(located.pose) @ transforms.inverse(device_from_view)
        return self._last_pose

    def eyes(self, at):
        """Return name, flags and pose of each space of the eyes in VIEW space, as recordings have them."""
        state, views = xr.locate_views(self.session, xr.ViewLocateInfo(STEREO, at, self.view))
        flags = int(state.view_state_flags)  # the same bits as locationFlags
        found = [(f"{eye}_view", flags, view.pose) for eye, view in zip(models, views, strict=True)]
        if self.eye_tracking == ANDROID:
            eyes = xr.get_fine_tracking_eyes_info_android(self._tracker, xr.EyesGetInfoANDROID(at, self.view))
            modes = xr.EyeTrackingModeANDROID
            for eye, mode, each in zip(models, (modes.LEFT, modes.RIGHT), eyes.eyes, strict=True):
                is_gazing = each.eye_state == xr.EyeStateANDROID.GAZING and eyes.mode in (mode, modes.BOTH)
                found.append((f"{eye}_pupil", 3 if is_gazing else 0, each.eye_pose))
        elif self.eye_tracking == FB:
            gazes = xr.get_eye_gazes_fb(self._tracker, xr.EyeGazesInfoFB(self.view, at))
            pairs = zip(models, gazes.gaze, strict=True)
            found += [(f"{eye}_gaze", 3 if each.is_valid else 0, each.gaze_pose) for eye, each in pairs]
        elif self.eye_tracking == EXT:
            actions, action, space = self._tracker
            active = (xr.ActiveActionSet * 1)(xr.ActiveActionSet(actions, 0))
            located = xr.locate_space(space, self.view, at)
            try:
                xr.sync_actions(self.session, xr.ActionsSyncInfo(active_action_sets=active))
                is_active = xr.get_action_state_pose(self.session, xr.ActionStateGetInfo(action=action)).is_active
            except xr.exception.SessionNotFocused:
                is_active = False
            found.append(("gaze", located.location_flags if is_active else 0, located.pose))
        valid = POSITION_AND_ORIENTATION_VALID  # else the pose is undefined
        return [(space, flags, pose if flags & valid == valid else xr.Posef()) for space, flags, pose in found]

    def recorded(self, at):
        """Lines of a recording (docs/files.md): head and eyes as OpenXR locates them at a time."""
        head = xr.locate_space(self.view, self.world, at)
        found = [("view", "local", head.location_flags, head.pose)]
        found += [(space, "view", flags, pose) for space, flags, pose in self.eyes(at)]
        for space, base_space, flags, pose in found:
            turn = dict(zip("xyzw", map(float, pose.orientation), strict=True))
            place = dict(zip("xyz", map(float, pose.position), strict=True))
            located = {"locationFlags": int(flags), "pose": {"orientation": turn, "position": place}}
            yield {"time": int(at), "space": space, "base_space": base_space, **located}

    def pupils(self, at):
        """Return each eye's entrance pupil (3,) in the device frame; None while it is not tracked."""
        found = {space: (flags, device_from_view @ rigid(pose)) for space, flags, pose in self.eyes(at)}
        samples = {}
        for eye in models:
            turning = wlr.RotatingEye.looking_ahead_from(found[f"{eye}_view"][1][:3, 3])
            space = next((each for each in (f"{eye}_pupil", f"{eye}_gaze", "gaze") if each in found), f"{eye}_view")
            flags, device_from_eye = found[space]
            if space != f"{eye}_pupil":  # the centre that the eye turns about is known from its view only
                flags &= found[f"{eye}_view"][0]
            if flags & POSITION_AND_ORIENTATION_VALID != POSITION_AND_ORIENTATION_VALID:
                samples[eye] = None
            elif space in (f"{eye}_pupil", f"{eye}_view"):
                samples[eye] = device_from_eye[:3, 3]
            elif space == f"{eye}_gaze":  # OpenXR does not say which point of the eye its position is
                samples[eye] = turning.viewpoint_of_gaze(-device_from_eye[:3, 2])
            else:
                fixated = device_from_eye[:3, 3] - FIXATION_M * device_from_eye[:3, 2]
                samples[eye] = turning.viewpoint_of_gaze(normalised(fixated - turning.rotation_centre_in_device))
        return samples


class SwapChains:
    """A swap chain for each eye, and the frames that a runtime shows from them."""

    def __init__(self, runtime):
        self._runtime, self.chains, self.textures = runtime, {}, {}
        usage = xr.SwapchainUsageFlags.COLOR_ATTACHMENT_BIT | xr.SwapchainUsageFlags.SAMPLED_BIT
        srgb8_alpha8 = 0x8C43  # the compositor writes sRGB codes
        sizes = {"width": SIZE[0], "height": SIZE[1], "face_count": 1, "array_size": 1, "mip_count": 1}
        for eye in models:
            wanted = xr.SwapchainCreateInfo(usage_flags=usage, format=srgb8_alpha8, sample_count=1, **sizes)
            chain = self.chains[eye] = xr.create_swapchain(runtime.session, wanted)
            images = xr.enumerate_swapchain_images(chain, xr.SwapchainImageOpenGLKHR)
            self.textures[eye] = [each.image for each in images]

    def begin(self):
        """Wait for the runtime's next frame: the time at which it will be shown."""
        at = xr.wait_frame(self._runtime.session).predicted_display_time
        xr.begin_frame(self._runtime.session)
        return at

    def acquired(self):
        """Return the OpenGL name of the texture to draw to, by eye."""
        names = {}
        for eye, chain in self.chains.items():
            index = xr.acquire_swapchain_image(chain, xr.SwapchainImageAcquireInfo())
            xr.wait_swapchain_image(chain, xr.SwapchainImageWaitInfo(timeout=xr.INFINITE_DURATION))
            names[eye] = self.textures[eye][index]
        return names

    def end(self, at):
        """Submit the images as one projection layer with the runtime's own poses and fields of view."""
        session, space = self._runtime.session, self._runtime.world
        for chain in self.chains.values():
            xr.release_swapchain_image(chain, xr.SwapchainImageReleaseInfo())
        _, views = xr.locate_views(session, xr.ViewLocateInfo(STEREO, at, space))
        whole = xr.Rect2Di(xr.Offset2Di(0, 0), xr.Extent2Di(*SIZE))
        shown = [
            xr.CompositionLayerProjectionView(
                pose=view.pose,
                fov=view.fov,
                sub_image=xr.SwapchainSubImage(swapchain=chain, image_rect=whole, image_array_index=0),
            )
            for view, chain in zip(views, self.chains.values(), strict=True)
        ]
        layer = xr.CompositionLayerProjection(
            space=space, views=(xr.CompositionLayerProjectionView * len(shown))(*shown)
        )
        opaque = xr.EnvironmentBlendMode.OPAQUE
        xr.end_frame(session, xr.FrameEndInfo(at, opaque, layers=[ctypes.byref(layer)]))


try:
    runtime = Runtime()
except (xr.exception.RuntimeUnavailableError, xr.exception.RuntimeFailureError) as error:
    raise SystemExit(f"no OpenXR runtime answers; start one, e.g. monado-service ({error})") from None
chains = SwapChains(runtime) if SWAP_CHAIN else None
panels = {eye: ctx.framebuffer([ctx.texture(SIZE, 4)]) for eye in models}  # framebuffers that replace a display
boxes = {eye: each.eye_box.centre for eye, each in models.items()}
synthetic = eye_motion(boxes, seed=3)  # used if the headset does not track eyes
filters = {eye: wlr.ViewpointFilter(centre) for eye, centre in boxes.items()}
heads, pose_ms, frame_ms, started = [], [], [], None
recording = [{"format": "wlr-openxr-recording", "version": 1, "device_from_view": device_from_view.tolist()}]
for number in range(FRAMES):
    at = chains.begin() if chains else runtime.now() + TO_FIRST_ROW_NS
    started = at if started is None else started
    begun = time.perf_counter()
    head, pupils = runtime.head_pose(at), {}
    for eye, sample in runtime.pupils(at).items():
        if runtime.eye_tracking is None:
            sample = synthetic.viewpoint_at(eye, (at - started) * 1e-9 % 10)
        followed = filters[eye].update(at * 1e-9, sample).viewpoint
        pupils[eye] = compositor.within_reach(eye, followed)
    pose_ms.append(1e3 * (time.perf_counter() - begun))
    draw_and_submit(compositor.begin_frame(head, pupils))
    if chains:  # no scan-out by rows: the runtime's own work comes in between
        names = chains.acquired()
        compositor.compose(into={eye: TextureLayer(name) for eye, name in names.items()}, pose=runtime.head_pose(at))
    else:
        newest = {"pose": runtime.head_pose(at), "pose_at_last_row": runtime.head_pose(at + SCAN_OUT_NS)}
        compositor.compose(into=panels, **newest)
    compositor.finish()  # only the times below need it, OpenXR does not
    if chains and number == FRAMES - 1:
        newest = runtime.head_pose(at)
        compositor.compose(into={eye: TextureLayer(name) for eye, name in names.items()}, pose=newest)
        ours = {eye: compositor.compose(pose=newest).read(eye) for eye in models}
        for eye, name in names.items():
            panels[eye] = ctx.framebuffer([ctx.external_texture(name, SIZE, 4, 0, "f1")])
    heads.append(head[:3, 3])
    recording += runtime.recorded(at)
    if chains and number < FRAMES - 1:
        chains.end(at)
    frame_ms.append(1e3 * (time.perf_counter() - begun))

for eye, panel in panels.items():
    shown = np.frombuffer(panel.read(components=3), np.uint8).reshape(SIZE[1], SIZE[0], 3)[::-1]
    write_png(f"{eye}.png", shown)
    if chains:
        difference = np.abs(shown.astype(int) - ours[eye]).max()
        print(f"{eye} eye: the swap chain's image differs from the compositor's by {difference} codes at most")
if chains:
    chains.end(at)
Path("recording.jsonl").write_text("".join(json.dumps(each) + "\n" for each in recording), encoding="utf-8")
moved_mm = 1e3 * np.ptp(heads, axis=0).max()
eyes = runtime.eye_tracking or "synthetic, as the runtime tracks none"
print(f"{runtime.name}: {FRAMES} frames; the head moved {moved_mm:.1f} mm; eyes: {eyes}")
print(f"milliseconds, median: poses {np.median(pose_ms):.2f}, frame {np.median(frame_ms):.1f}")
compositor.release()
print("OpenGL:", ctx.error)
xr.destroy_session(runtime.session)
xr.destroy_instance(runtime.instance)
