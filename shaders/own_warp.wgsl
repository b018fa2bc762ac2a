// own_warp.glsl in WGSL, whose first lines say how to draw it. Entry points: tiles_vertex, tiles_fragment, vertex, fragment.
// Written by release/own_warp.py with naga 30.
// SHA-256 of the GLSL's tokens and of the text below: 3a09524375d49f75c54a45db553775133b9d640ab7e271fa8d8a47fd343d5688

struct tiles_vertex_Warp {
    image_from_ray: array<vec4<f32>, 3>,
    clip_from_panel: vec4<f32>,
    inverse_depth_of_0_and_1_: vec2<f32>,
    nothing: f32,
    nearest: f32,
    background: vec3<f32>,
    opaque: f32,
    most_samples_per_axis: f32,
}

struct tiles_vertex_VertexOutput {
    @builtin(position) tiles_vertex_gl_Position: vec4<f32>,
}

@group(0) @binding(0)
var<uniform> tiles_vertex_global: tiles_vertex_Warp;
var<private> tiles_vertex_gl_Position: vec4<f32>;
var<private> tiles_vertex_gl_VertexIndex_1: u32;

fn tiles_vertex_main_1() {
    var local: f32;
    var local_1: f32;

    let _e18 = tiles_vertex_gl_VertexIndex_1;
    if (_e18 == 1u) {
        local = 3f;
    } else {
        local = -1f;
    }
    let _e26 = local;
    let _e27 = tiles_vertex_gl_VertexIndex_1;
    if (_e27 == 2u) {
        local_1 = 3f;
    } else {
        local_1 = -1f;
    }
    let _e35 = local_1;
    tiles_vertex_gl_Position = vec4<f32>(_e26, _e35, 0f, 1f);
    return;
}

@vertex
fn tiles_vertex(@builtin(vertex_index) gl_VertexIndex: u32) -> tiles_vertex_VertexOutput {
    tiles_vertex_gl_VertexIndex_1 = gl_VertexIndex;
    tiles_vertex_main_1();
    let _e19 = tiles_vertex_gl_Position;
    return tiles_vertex_VertexOutput(_e19);
}

struct tiles_fragment_Warp {
    image_from_ray: array<vec4<f32>, 3>,
    clip_from_panel: vec4<f32>,
    inverse_depth_of_0_and_1_: vec2<f32>,
    nothing: f32,
    nearest: f32,
    background: vec3<f32>,
    opaque: f32,
    most_samples_per_axis: f32,
}

struct tiles_fragment_FragmentOutput {
    @location(0) tiles_fragment_range: vec2<f32>,
}

@group(0) @binding(0)
var<uniform> tiles_fragment_global: tiles_fragment_Warp;
@group(0) @binding(4)
var tiles_fragment_between_texels: sampler;
@group(0) @binding(5)
var tiles_fragment_nearest_texel: sampler;
@group(0) @binding(2)
var tiles_fragment_depth: texture_2d<f32>;
var<private> tiles_fragment_range: vec2<f32>;
var<private> tiles_fragment_gl_FragCoord_1: vec4<f32>;

fn tiles_fragment_size_of(image: texture_2d<f32>) -> vec2<i32> {
    let _e20 = textureDimensions(image, 0i);
    return vec2<i32>(_e20);
}

fn tiles_fragment_fetched(image_1: texture_2d<f32>, texel: vec2<i32>) -> vec4<f32> {
    var texel_1: vec2<i32>;

    texel_1 = texel;
    let _e21 = texel_1;
    let _e23 = textureLoad(image_1, _e21, 0i);
    return _e23;
}

fn tiles_fragment_gathered(image_2: texture_2d<f32>, shared_corner: vec2<f32>) -> vec4<f32> {
    var shared_corner_1: vec2<f32>;
    var last: vec2<i32>;
    var corner: vec2<i32>;
    var low: vec2<i32>;
    var high: vec2<i32>;

    shared_corner_1 = shared_corner;
    let _e21 = tiles_fragment_size_of(image_2);
    last = (_e21 - vec2(1i));
    let _e26 = shared_corner_1;
    let _e27 = last;
    corner = vec2<i32>(round((_e26 * vec2<f32>((_e27 + vec2(1i))))));
    let _e36 = corner;
    let _e42 = last;
    low = clamp((_e36 - vec2(1i)), vec2(0i), _e42);
    let _e45 = corner;
    let _e48 = last;
    high = clamp(_e45, vec2(0i), _e48);
    let _e51 = low;
    let _e53 = high;
    let _e56 = tiles_fragment_fetched(image_2, vec2<i32>(_e51.x, _e53.y));
    let _e58 = high;
    let _e59 = tiles_fragment_fetched(image_2, _e58);
    let _e61 = high;
    let _e63 = low;
    let _e66 = tiles_fragment_fetched(image_2, vec2<i32>(_e61.x, _e63.y));
    let _e68 = low;
    let _e69 = tiles_fragment_fetched(image_2, _e68);
    return vec4<f32>(_e56.x, _e59.x, _e66.x, _e69.x);
}

fn tiles_fragment_sampled(image_3: texture_2d<f32>, place: vec2<f32>) -> vec4<f32> {
    var place_1: vec2<f32>;

    place_1 = place;
    let _e21 = place_1;
    let _e23 = textureSampleLevel(image_3, tiles_fragment_between_texels, _e21, 0f);
    return _e23;
}

fn tiles_fragment_nearest_sampled(image_4: texture_2d<f32>, place_2: vec2<f32>) -> vec4<f32> {
    var place_3: vec2<f32>;

    place_3 = place_2;
    let _e21 = place_3;
    let _e23 = textureSampleLevel(image_4, tiles_fragment_nearest_texel, _e21, 0f);
    return _e23;
}

fn tiles_fragment_inverse_depths(stored: vec4<f32>) -> vec4<f32> {
    var stored_1: vec4<f32>;
    var between: vec4<f32>;

    stored_1 = stored;
    let _e21 = stored_1;
    let _e24 = tiles_fragment_global.inverse_depth_of_0_and_1_;
    let _e27 = stored_1;
    let _e28 = tiles_fragment_global.inverse_depth_of_0_and_1_;
    between = (((vec4(1f) - _e21) * _e24.x) + (_e27 * _e28.y));
    let _e35 = between;
    let _e39 = stored_1;
    let _e40 = tiles_fragment_global.nothing;
    return select(vec4(0f), max(_e35, vec4(0f)), (_e39 != vec4(_e40)));
}

fn tiles_fragment_range_of_tile(values: texture_2d<f32>, tile: vec2<f32>) -> vec2<f32> {
    var tile_1: vec2<f32>;
    var per_texel: vec2<f32>;
    var first: vec2<f32>;
    var low_1: vec4<f32>;
    var high_1: vec4<f32>;
    var k: i32 = 1i;
    var shared_corner_2: vec2<f32>;
    var four: vec4<f32>;

    tile_1 = tile;
    let _e24 = tiles_fragment_size_of(values);
    per_texel = (vec2(1f) / vec2<f32>(_e24));
    let _e29 = tile_1;
    first = ((floor(_e29) * 8f) + vec2(1f));
    let _e38 = first;
    let _e39 = per_texel;
    let _e41 = tiles_fragment_gathered(values, (_e38 * _e39));
    let _e42 = tiles_fragment_inverse_depths(_e41);
    low_1 = _e42;
    let _e44 = low_1;
    high_1 = _e44;
    loop {
        let _e48 = k;
        if !((_e48 < 16i)) {
            break;
        }
        {
            let _e59 = first;
            let _e61 = k;
            let _e66 = k;
            shared_corner_2 = (_e59 + (2f * vec2<f32>(f32((_e61 % 4i)), f32((_e66 / 4i)))));
            let _e77 = shared_corner_2;
            let _e78 = per_texel;
            let _e80 = tiles_fragment_gathered(values, (_e77 * _e78));
            let _e81 = tiles_fragment_inverse_depths(_e80);
            four = _e81;
            let _e83 = low_1;
            let _e84 = four;
            low_1 = min(_e83, _e84);
            let _e86 = high_1;
            let _e87 = four;
            high_1 = max(_e86, _e87);
        }
        continuing {
            let _e56 = k;
            k = (_e56 + 1i);
        }
    }
    let _e89 = low_1;
    let _e91 = low_1;
    let _e94 = low_1;
    let _e96 = low_1;
    let _e100 = high_1;
    let _e102 = high_1;
    let _e105 = high_1;
    let _e107 = high_1;
    return vec2<f32>(min(min(_e89.x, _e91.y), min(_e94.z, _e96.w)), max(max(_e100.x, _e102.y), max(_e105.z, _e107.w)));
}

fn tiles_fragment_main_1() {
    let _e21 = tiles_fragment_gl_FragCoord_1;
    let _e23 = tiles_fragment_range_of_tile(tiles_fragment_depth, _e21.xy);
    tiles_fragment_range = _e23;
    return;
}

@fragment
fn tiles_fragment(@builtin(position) gl_FragCoord: vec4<f32>) -> tiles_fragment_FragmentOutput {
    tiles_fragment_gl_FragCoord_1 = gl_FragCoord;
    tiles_fragment_main_1();
    let _e27 = tiles_fragment_range;
    return tiles_fragment_FragmentOutput(_e27);
}

struct vertex_Warp {
    image_from_ray: array<vec4<f32>, 3>,
    clip_from_panel: vec4<f32>,
    inverse_depth_of_0_and_1_: vec2<f32>,
    nothing: f32,
    nearest: f32,
    background: vec3<f32>,
    opaque: f32,
    most_samples_per_axis: f32,
}

struct vertex_VertexOutput {
    @location(0) vertex_ray: vec4<f32>,
    @location(1) vertex_has_ray: f32,
    @builtin(position) vertex_gl_Position: vec4<f32>,
}

@group(0) @binding(0)
var<uniform> vertex_global: vertex_Warp;
var<private> vertex_panel_position_1: vec2<f32>;
var<private> vertex_vertex_ray_1: vec4<f32>;
var<private> vertex_ray: vec4<f32>;
var<private> vertex_has_ray: f32;
var<private> vertex_gl_Position: vec4<f32>;

fn vertex_main_1() {
    var missing: bool;
    var local: vec4<f32>;
    var local_1: f32;

    let _e20 = vertex_vertex_ray_1;
    missing = any(((bitcast<vec4<u32>>(_e20) & vec4(2147483647u)) > vec4(2139095040u)));
    let _e30 = missing;
    if _e30 {
        local = vec4(0f);
    } else {
        let _e33 = vertex_vertex_ray_1;
        local = _e33;
    }
    let _e35 = local;
    vertex_ray = _e35;
    let _e36 = missing;
    if _e36 {
        local_1 = 0f;
    } else {
        local_1 = 1f;
    }
    let _e40 = local_1;
    vertex_has_ray = _e40;
    let _e42 = vertex_panel_position_1;
    let _e43 = vertex_global.clip_from_panel;
    let _e46 = vertex_global.clip_from_panel;
    let _e48 = ((_e42 * _e43.xy) + _e46.zw);
    vertex_gl_Position = vec4<f32>(_e48.x, _e48.y, 0f, 1f);
    return;
}

@vertex
fn vertex(@location(0) panel_position: vec2<f32>, @location(1) vertex_ray: vec4<f32>) -> vertex_VertexOutput {
    vertex_panel_position_1 = panel_position;
    vertex_vertex_ray_1 = vertex_ray;
    vertex_main_1();
    let _e29 = vertex_ray;
    let _e31 = vertex_has_ray;
    let _e33 = vertex_gl_Position;
    return vertex_VertexOutput(_e29, _e31, _e33);
}

struct fragment_Warp {
    image_from_ray: array<vec4<f32>, 3>,
    clip_from_panel: vec4<f32>,
    inverse_depth_of_0_and_1_: vec2<f32>,
    nothing: f32,
    nearest: f32,
    background: vec3<f32>,
    opaque: f32,
    most_samples_per_axis: f32,
}

struct fragment_FragmentOutput {
    @location(0) fragment_colour: vec4<f32>,
}

const fragment_is_inset: bool = false;
const fragment_is_backdrop: bool = false;
const fragment_is_needed: bool = true;
const fragment_filled: f32 = 0f;
const fragment_nearest_shown: f32 = 1000000000000000000000000000000f;
const fragment_widest_from_inset: vec4<f32> = vec4<f32>(1f, 1f, 0f, 0f);
const fragment_grid_place: vec2<f32> = vec2(0f);
const fragment_cell: vec2<f32> = vec2(0f);
const fragment_NUDGE_PX: f32 = 0.001f;
const fragment_MARGIN_PX: f32 = 8f;
const fragment_UNKNOWN: f32 = -1f;

@group(0) @binding(0)
var<uniform> fragment_global: fragment_Warp;
@group(0) @binding(4)
var fragment_between_texels: sampler;
@group(0) @binding(5)
var fragment_nearest_texel: sampler;
var<private> fragment_ray_3: vec4<f32>;
var<private> fragment_has_ray_1: f32;
var<private> fragment_colour: vec4<f32>;
var<private> fragment_range_2: vec2<f32>;
var<private> fragment_samples_per_axis: f32;
var<private> fragment_is_direct: bool;
var<private> fragment_known: array<f32, 1>;
var<private> fragment_path: array<vec4<f32>, 1>;
var<private> fragment_bend: array<vec4<f32>, 1>;
var<private> fragment_sides: vec4<f32>;
var<private> fragment_mixed_bend: array<vec2<f32>, 1>;
@group(0) @binding(1)
var fragment_picture: texture_2d<f32>;
@group(0) @binding(2)
var fragment_inverse_depth: texture_2d<f32>;
var<private> fragment_size_px: vec2<f32>;
var<private> fragment_per_texel: vec2<f32>;
@group(0) @binding(3)
var fragment_tiles: texture_2d<f32>;
var<private> fragment_light_2: vec3<f32> = vec3(0f);
var<private> fragment_alpha: f32 = 0f;
var<private> fragment_worst: i32 = 0i;
var<private> fragment_seen_at: vec2<f32> = vec2(0f);

fn fragment_size_of(image: texture_2d<f32>) -> vec2<i32> {
    let _e20 = textureDimensions(image, 0i);
    return vec2<i32>(_e20);
}

fn fragment_fetched(image_1: texture_2d<f32>, texel: vec2<i32>) -> vec4<f32> {
    var texel_1: vec2<i32>;

    texel_1 = texel;
    let _e21 = texel_1;
    let _e23 = textureLoad(image_1, _e21, 0i);
    return _e23;
}

fn fragment_gathered(image_2: texture_2d<f32>, shared_corner: vec2<f32>) -> vec4<f32> {
    var shared_corner_1: vec2<f32>;
    var last: vec2<i32>;
    var corner: vec2<i32>;
    var low: vec2<i32>;
    var high: vec2<i32>;

    shared_corner_1 = shared_corner;
    let _e21 = fragment_size_of(image_2);
    last = (_e21 - vec2(1i));
    let _e26 = shared_corner_1;
    let _e27 = last;
    corner = vec2<i32>(round((_e26 * vec2<f32>((_e27 + vec2(1i))))));
    let _e36 = corner;
    let _e42 = last;
    low = clamp((_e36 - vec2(1i)), vec2(0i), _e42);
    let _e45 = corner;
    let _e48 = last;
    high = clamp(_e45, vec2(0i), _e48);
    let _e51 = low;
    let _e53 = high;
    let _e56 = fragment_fetched(image_2, vec2<i32>(_e51.x, _e53.y));
    let _e58 = high;
    let _e59 = fragment_fetched(image_2, _e58);
    let _e61 = high;
    let _e63 = low;
    let _e66 = fragment_fetched(image_2, vec2<i32>(_e61.x, _e63.y));
    let _e68 = low;
    let _e69 = fragment_fetched(image_2, _e68);
    return vec4<f32>(_e56.x, _e59.x, _e66.x, _e69.x);
}

fn fragment_sampled(image_3: texture_2d<f32>, place: vec2<f32>) -> vec4<f32> {
    var place_1: vec2<f32>;

    place_1 = place;
    let _e21 = place_1;
    let _e23 = textureSampleLevel(image_3, fragment_between_texels, _e21, 0f);
    return _e23;
}

fn fragment_nearest_sampled(image_4: texture_2d<f32>, place_2: vec2<f32>) -> vec4<f32> {
    var place_3: vec2<f32>;

    place_3 = place_2;
    let _e21 = place_3;
    let _e23 = textureSampleLevel(image_4, fragment_nearest_texel, _e21, 0f);
    return _e23;
}

fn fragment_inverse_depths(stored: vec4<f32>) -> vec4<f32> {
    var stored_1: vec4<f32>;
    var between: vec4<f32>;

    stored_1 = stored;
    let _e21 = stored_1;
    let _e24 = fragment_global.inverse_depth_of_0_and_1_;
    let _e27 = stored_1;
    let _e28 = fragment_global.inverse_depth_of_0_and_1_;
    between = (((vec4(1f) - _e21) * _e24.x) + (_e27 * _e28.y));
    let _e35 = between;
    let _e39 = stored_1;
    let _e40 = fragment_global.nothing;
    return select(vec4(0f), max(_e35, vec4(0f)), (_e39 != vec4(_e40)));
}

fn fragment_project_ray(ray_1: vec4<f32>, row_u: vec4<f32>, row_v: vec4<f32>, row_depth: vec4<f32>, at_infinity: ptr<function, vec2<f32>>, shift: ptr<function, vec2<f32>>) -> bool {
    var ray_2: vec4<f32>;
    var row_u_1: vec4<f32>;
    var row_v_1: vec4<f32>;
    var row_depth_1: vec4<f32>;
    var depth: f32;
    var forwards: vec2<f32>;
    var local: f32;
    var start: vec2<f32>;

    ray_2 = ray_1;
    row_u_1 = row_u;
    row_v_1 = row_v;
    row_depth_1 = row_depth;
    let _e28 = row_depth_1;
    let _e30 = ray_2;
    let _e33 = row_depth_1;
    depth = (dot(_e28.xy, _e30.xy) - _e33.z);
    let _e37 = row_u_1;
    let _e39 = ray_2;
    let _e42 = row_u_1;
    let _e45 = row_v_1;
    let _e47 = ray_2;
    let _e50 = row_v_1;
    forwards = vec2<f32>((dot(_e37.xy, _e39.xy) - _e42.z), (dot(_e45.xy, _e47.xy) - _e50.z));
    let _e55 = forwards;
    let _e56 = depth;
    if (_e56 > 0f) {
        let _e59 = depth;
        local = _e59;
    } else {
        local = 1f;
    }
    let _e62 = local;
    (*at_infinity) = (_e55 / vec2(_e62));
    let _e65 = row_u_1;
    let _e67 = ray_2;
    let _e70 = row_u_1;
    let _e73 = row_v_1;
    let _e75 = ray_2;
    let _e78 = row_v_1;
    start = vec2<f32>((dot(_e65.xy, _e67.zw) + _e70.w), (dot(_e73.xy, _e75.zw) + _e78.w));
    let _e83 = start;
    let _e84 = row_depth_1;
    let _e86 = ray_2;
    let _e89 = row_depth_1;
    let _e92 = (*at_infinity);
    (*shift) = (_e83 - ((dot(_e84.xy, _e86.zw) + _e89.w) * _e92));
    let _e95 = depth;
    return (_e95 > 0f);
}

fn fragment_largest_stretch(image_by_display: mat2x2<f32>) -> f32 {
    var image_by_display_1: mat2x2<f32>;
    var squares: f32;
    var area: f32;

    image_by_display_1 = image_by_display;
    let _e22 = image_by_display_1[0];
    let _e25 = image_by_display_1[0];
    let _e29 = image_by_display_1[1];
    let _e32 = image_by_display_1[1];
    squares = (dot(_e22, _e25) + dot(_e29, _e32));
    let _e36 = image_by_display_1;
    area = determinant(_e36);
    let _e40 = squares;
    let _e41 = squares;
    let _e42 = squares;
    let _e45 = area;
    let _e47 = area;
    return sqrt((0.5f * (_e40 + sqrt(max(((_e41 * _e42) - ((4f * _e45) * _e47)), 0f)))));
}

fn fragment_bilinear_taps(pixel: vec2<f32>, base: ptr<function, vec2<f32>>, weight: ptr<function, vec2<f32>>) {
    var pixel_1: vec2<f32>;

    pixel_1 = pixel;
    let _e22 = pixel_1;
    (*base) = floor((_e22 - vec2(0.5f)));
    let _e27 = pixel_1;
    let _e31 = (*base);
    (*weight) = ((_e27 - vec2(0.5f)) - _e31);
    return;
}

fn fragment_sides_of_pixel(channel: i32, across: ptr<function, vec2<f32>>, down: ptr<function, vec2<f32>>) {
    let _e40 = fragment_sides;
    (*across) = _e40.xy;
    let _e42 = fragment_sides;
    (*down) = _e42.zw;
    return;
}

fn fragment_inverse_depth_at(pixel_2: vec2<f32>) -> f32 {
    var pixel_3: vec2<f32>;

    pixel_3 = pixel_2;
    let _e47 = pixel_3;
    let _e48 = fragment_per_texel;
    let _e50 = fragment_nearest_sampled(fragment_inverse_depth, (_e47 * _e48));
    let _e51 = fragment_inverse_depths(_e50);
    return _e51.x;
}

fn fragment_smooth_inverse_depth(pixel_4: vec2<f32>) -> f32 {
    var pixel_5: vec2<f32>;
    var base_1: vec2<f32>;
    var weight_1: vec2<f32>;
    var shared_corner_2: vec2<f32>;
    var texels: vec4<f32>;
    var high_1: f32;
    var low_1: f32;
    var local_1: vec2<f32>;

    pixel_5 = pixel_4;
    let _e49 = pixel_5;
    fragment_bilinear_taps(_e49, (&base_1), (&weight_1));
    let _e54 = base_1;
    let _e58 = fragment_per_texel;
    shared_corner_2 = ((_e54 + vec2(1f)) * _e58);
    let _e61 = shared_corner_2;
    let _e62 = fragment_gathered(fragment_inverse_depth, _e61);
    let _e63 = fragment_inverse_depths(_e62);
    texels = _e63;
    let _e65 = texels;
    let _e67 = texels;
    let _e70 = texels;
    let _e72 = texels;
    high_1 = max(max(_e65.x, _e67.y), max(_e70.z, _e72.w));
    let _e77 = texels;
    let _e79 = texels;
    let _e82 = texels;
    let _e84 = texels;
    low_1 = min(min(_e77.x, _e79.y), min(_e82.z, _e84.w));
    let _e89 = high_1;
    let _e90 = low_1;
    let _e93 = high_1;
    if ((_e89 - _e90) > (0.02f * _e93)) {
        let _e97 = weight_1;
        local_1 = step(vec2(0.5f), _e97);
    } else {
        let _e100 = weight_1;
        local_1 = _e100;
    }
    let _e102 = local_1;
    weight_1 = _e102;
    let _e103 = texels;
    let _e105 = texels;
    let _e107 = weight_1;
    let _e110 = texels;
    let _e112 = texels;
    let _e114 = weight_1;
    let _e117 = weight_1;
    return mix(mix(_e103.w, _e105.z, _e107.x), mix(_e110.x, _e112.y, _e114.x), _e117.y);
}

fn fragment_is_one_surface(one: f32, other: f32, half_px: f32) -> bool {
    var one_1: f32;
    var other_1: f32;
    var half_px_1: f32;

    one_1 = one;
    other_1 = other;
    half_px_1 = half_px;
    let _e51 = one_1;
    let _e52 = other_1;
    let _e56 = one_1;
    let _e57 = other_1;
    let _e60 = half_px_1;
    return (abs((_e51 - _e52)) <= max((0.02f * max(_e56, _e57)), _e60));
}

fn fragment_place_on_surface(pixel_6: vec2<f32>, met: f32, half_px_2: f32) -> vec2<f32> {
    var pixel_7: vec2<f32>;
    var met_1: f32;
    var half_px_3: f32;
    var base_2: vec2<f32>;
    var weight_2: vec2<f32>;
    var texels_1: vec4<f32>;
    var belongs: vec4<f32>;
    var share: vec4<f32>;
    var largest: f32;
    var own: vec2<f32>;
    var row: f32;
    var column: f32;
    var all_belong: bool;
    var local_2: vec2<f32>;
    var local_3: vec2<f32>;
    var moved: vec2<f32>;
    var local_4: vec2<f32>;

    pixel_7 = pixel_6;
    met_1 = met;
    half_px_3 = half_px_2;
    let _e53 = pixel_7;
    fragment_bilinear_taps(_e53, (&base_2), (&weight_2));
    let _e58 = base_2;
    let _e62 = fragment_per_texel;
    let _e64 = fragment_gathered(fragment_inverse_depth, ((_e58 + vec2(1f)) * _e62));
    let _e65 = fragment_inverse_depths(_e64);
    texels_1 = _e65;
    let _e67 = texels_1;
    let _e68 = met_1;
    let _e73 = texels_1;
    let _e74 = met_1;
    let _e78 = half_px_3;
    belongs = select(vec4(0f), vec4(1f), (abs((_e67 - vec4(_e68))) <= max((0.02f * max(_e73, vec4(_e74))), vec4(_e78))));
    let _e88 = belongs;
    let _e90 = weight_2;
    let _e93 = weight_2;
    let _e94 = _e93.xx;
    let _e96 = weight_2;
    let _e103 = weight_2;
    let _e104 = _e103.yy;
    let _e106 = weight_2;
    let _e109 = (vec2(1f) - _e106.yy);
    share = ((_e88 * vec4<f32>((1f - _e90.x), _e94.x, _e94.y, (1f - _e96.x))) * vec4<f32>(_e104.x, _e104.y, _e109.x, _e109.y));
    let _e117 = share;
    let _e119 = share;
    let _e122 = share;
    let _e124 = share;
    largest = max(max(_e117.x, _e119.y), max(_e122.z, _e124.w));
    let _e129 = share;
    let _e131 = share;
    let _e134 = largest;
    let _e136 = share;
    let _e138 = share;
    let _e141 = largest;
    own = vec2<f32>(f32((max(_e129.y, _e131.z) == _e134)), f32((max(_e136.x, _e138.y) == _e141)));
    let _e147 = belongs;
    let _e149 = belongs;
    let _e152 = belongs;
    let _e154 = belongs;
    let _e157 = own;
    row = mix((_e147.z * _e149.w), (_e152.x * _e154.y), _e157.y);
    let _e161 = belongs;
    let _e163 = belongs;
    let _e166 = belongs;
    let _e168 = belongs;
    let _e171 = own;
    column = mix((_e161.x * _e163.w), (_e166.y * _e168.z), _e171.x);
    let _e175 = belongs;
    let _e177 = belongs;
    let _e180 = belongs;
    let _e183 = belongs;
    all_belong = ((((_e175.x * _e177.y) * _e180.z) * _e183.w) == 1f);
    let _e189 = row;
    if (_e189 == 1f) {
        let _e192 = weight_2;
        let _e194 = own;
        local_3 = vec2<f32>(_e192.x, _e194.y);
    } else {
        let _e197 = column;
        if (_e197 == 1f) {
            let _e200 = own;
            let _e202 = weight_2;
            local_2 = vec2<f32>(_e200.x, _e202.y);
        } else {
            let _e205 = own;
            local_2 = _e205;
        }
        let _e207 = local_2;
        local_3 = _e207;
    }
    let _e209 = local_3;
    moved = _e209;
    let _e211 = base_2;
    let _e215 = all_belong;
    let _e216 = largest;
    if (_e215 || (_e216 == 0f)) {
        let _e220 = weight_2;
        local_4 = _e220;
    } else {
        let _e221 = moved;
        local_4 = _e221;
    }
    let _e223 = local_4;
    return ((_e211 + vec2(0.5f)) + _e223);
}

fn fragment_march(at_infinity_1: vec2<f32>, shift_1: vec2<f32>, range: vec2<f32>, pixel_8: ptr<function, vec2<f32>>, seen_there: ptr<function, f32>, half_px_4: ptr<function, f32>) -> i32 {
    var at_infinity_2: vec2<f32>;
    var shift_2: vec2<f32>;
    var range_1: vec2<f32>;
    var px_per_inverse_depth: f32;
    var one_px: f32;
    var nudge: vec2<f32>;
    var ahead: vec2<f32>;
    var per_shift: vec2<f32>;
    var tiles_per_px: vec2<f32>;
    var from_first: vec2<f32>;
    var from_last: vec2<f32>;
    var enters: vec2<f32>;
    var leaves_image: vec2<f32>;
    var last_1: f32;
    var far_end: f32;
    var here: f32;
    var never_enters: bool;
    var before: f32 = fragment_UNKNOWN;
    var met_2: f32;
    var in_front: bool = true;
    var meets: bool = false;
    var searching: bool = true;
    var place_4: vec2<f32>;
    var texel_2: vec2<f32>;
    var tile: vec2<f32>;
    var leaves: vec2<f32>;
    var leaves_tile: vec2<f32>;
    var end: f32;
    var end_of_tile: f32;
    var bounds: vec2<f32>;
    var seen: f32;
    var is_behind: bool;
    var behind_tile: bool;
    var skips: bool;
    var joins: bool;
    var edge: bool;
    var local_5: f32;
    var local_6: f32;
    var local_7: f32;
    var local_8: f32;
    var local_9: bool;
    var local_10: f32;
    var local_11: f32;
    var second: f32;
    var third: f32;
    var first_step: f32;
    var second_step: f32;
    var converges: bool;
    var local_12: f32;
    var limit: f32;
    var stays: bool;
    var is_outside: bool;
    var local_13: f32;
    var local_14: vec2<f32>;
    var local_15: f32;
    var local_16: i32;

    at_infinity_2 = at_infinity_1;
    shift_2 = shift_1;
    range_1 = range;
    let _e54 = shift_2;
    px_per_inverse_depth = max(length(_e54), 0.000000000001f);
    let _e60 = px_per_inverse_depth;
    one_px = (1f / _e60);
    let _e65 = one_px;
    let _e67 = shift_2;
    nudge = ((-0.001f * _e65) * _e67);
    let _e70 = shift_2;
    ahead = select(vec2(0f), vec2(1f), (_e70 < vec2(0f)));
    let _e82 = ahead;
    let _e86 = shift_2;
    per_shift = ((vec2(1f) - (2f * _e82)) / max(abs(_e86), vec2(0.000000000001f)));
    let _e96 = fragment_size_of(fragment_tiles);
    tiles_per_px = (vec2(1f) / (8f * vec2<f32>(_e96)));
    let _e104 = at_infinity_2;
    let _e107 = per_shift;
    from_first = ((vec2(-8f) - _e104) * _e107);
    let _e110 = fragment_size_px;
    let _e114 = at_infinity_2;
    let _e116 = per_shift;
    from_last = (((_e110 + vec2(8f)) - _e114) * _e116);
    let _e119 = from_first;
    let _e120 = from_last;
    enters = max(_e119, _e120);
    let _e123 = from_first;
    let _e124 = from_last;
    leaves_image = min(_e123, _e124);
    let _e127 = range_1;
    last_1 = (_e127.x * 0.999999f);
    let _e134 = last_1;
    let _e135 = leaves_image;
    let _e137 = leaves_image;
    far_end = max(_e134, max(_e135.x, _e137.y));
    let _e142 = range_1;
    let _e148 = enters;
    let _e150 = enters;
    here = min((_e142.y * 1.000001f), min(_e148.x, _e150.y));
    let _e155 = here;
    let _e156 = far_end;
    never_enters = (_e155 < _e156);
    let _e160 = here;
    met_2 = _e160;
    loop {
        {
            let _e168 = at_infinity_2;
            let _e169 = here;
            let _e170 = shift_2;
            let _e173 = nudge;
            place_4 = ((_e168 + (_e169 * _e170)) + _e173);
            let _e176 = place_4;
            texel_2 = floor(_e176);
            let _e179 = place_4;
            tile = floor((_e179 / vec2(8f)));
            let _e186 = texel_2;
            let _e187 = ahead;
            let _e189 = at_infinity_2;
            let _e191 = per_shift;
            leaves = (((_e186 + _e187) - _e189) * _e191);
            let _e194 = tile;
            let _e195 = ahead;
            let _e200 = at_infinity_2;
            let _e202 = per_shift;
            leaves_tile = ((((_e194 + _e195) * 8f) - _e200) * _e202);
            let _e205 = leaves;
            let _e206 = here;
            let _e207 = one_px;
            let _e210 = leaves;
            let _e211 = here;
            leaves = select(_e205, vec2((_e206 - _e207)), (_e210 >= vec2(_e211)));
            let _e215 = leaves_tile;
            let _e216 = here;
            let _e217 = one_px;
            let _e220 = leaves_tile;
            let _e221 = here;
            leaves_tile = select(_e215, vec2((_e216 - _e217)), (_e220 >= vec2(_e221)));
            let _e225 = leaves;
            let _e227 = leaves;
            let _e230 = far_end;
            end = max(max(_e225.x, _e227.y), _e230);
            let _e233 = leaves_tile;
            let _e235 = leaves_tile;
            let _e238 = far_end;
            end_of_tile = max(max(_e233.x, _e235.y), _e238);
            let _e241 = tile;
            let _e248 = tiles_per_px;
            let _e250 = fragment_nearest_sampled(fragment_tiles, (((_e241 + vec2(0.5f)) * 8f) * _e248));
            bounds = _e250.xy;
            let _e253 = texel_2;
            let _e257 = fragment_inverse_depth_at((_e253 + vec2(0.5f)));
            seen = _e257;
            let _e259 = seen;
            let _e260 = here;
            is_behind = (_e259 > _e260);
            let _e263 = in_front;
            let _e265 = bounds;
            let _e267 = here;
            let _e270 = bounds;
            let _e272 = bounds;
            let _e275 = one_px;
            let _e277 = fragment_is_one_surface(_e270.x, _e272.y, (0.5f * _e275));
            behind_tile = ((!(_e263) && (_e265.x > _e267)) && _e277);
            let _e280 = bounds;
            let _e282 = end_of_tile;
            let _e284 = behind_tile;
            skips = ((_e280.y < _e282) || _e284);
            let _e287 = before;
            let _e289 = before;
            let _e290 = seen;
            let _e292 = one_px;
            let _e294 = fragment_is_one_surface(_e289, _e290, (0.5f * _e292));
            joins = ((_e287 == fragment_UNKNOWN) || _e294);
            let _e297 = meets;
            let _e298 = searching;
            let _e299 = skips;
            let _e302 = seen;
            let _e303 = end;
            let _e306 = is_behind;
            let _e308 = in_front;
            let _e309 = joins;
            meets = (_e297 || (((_e298 && !(_e299)) && (_e302 >= _e303)) && (!(_e306) || (_e308 && _e309))));
            let _e314 = meets;
            let _e316 = skips;
            let _e319 = is_behind;
            let _e321 = joins;
            edge = (((!(_e314) && !(_e316)) && _e319) && !(_e321));
            let _e325 = searching;
            if !(_e325) {
                let _e327 = met_2;
                local_7 = _e327;
            } else {
                let _e328 = meets;
                if _e328 {
                    let _e329 = seen;
                    let _e330 = here;
                    local_6 = min(_e329, _e330);
                } else {
                    let _e332 = edge;
                    if _e332 {
                        let _e333 = seen;
                        let _e334 = before;
                        local_5 = max(_e333, _e334);
                    } else {
                        let _e336 = met_2;
                        local_5 = _e336;
                    }
                    let _e338 = local_5;
                    local_6 = _e338;
                }
                let _e340 = local_6;
                local_7 = _e340;
            }
            let _e342 = local_7;
            met_2 = _e342;
            let _e343 = skips;
            if _e343 {
                let _e344 = bounds;
                local_8 = _e344.y;
            } else {
                let _e346 = seen;
                local_8 = _e346;
            }
            let _e348 = local_8;
            before = _e348;
            let _e349 = searching;
            let _e350 = skips;
            if (_e349 && !(_e350)) {
                let _e353 = is_behind;
                local_9 = !(_e353);
            } else {
                let _e355 = in_front;
                local_9 = _e355;
            }
            let _e357 = local_9;
            in_front = _e357;
            let _e358 = meets;
            if _e358 {
                let _e359 = here;
                local_11 = _e359;
            } else {
                let _e360 = skips;
                if _e360 {
                    let _e361 = end_of_tile;
                    local_10 = _e361;
                } else {
                    let _e362 = end;
                    local_10 = _e362;
                }
                let _e364 = local_10;
                let _e365 = here;
                local_11 = min(_e364, (_e365 * 0.9999999f));
            }
            let _e372 = local_11;
            here = _e372;
            let _e373 = meets;
            let _e375 = here;
            let _e376 = far_end;
            searching = (!(_e373) && (_e375 > _e376));
        }
        let _e379 = searching;
        if !(_e379) {
            break;
        }
    }
    let _e381 = at_infinity_2;
    let _e382 = met_2;
    let _e383 = shift_2;
    let _e386 = fragment_smooth_inverse_depth((_e381 + (_e382 * _e383)));
    second = _e386;
    let _e388 = at_infinity_2;
    let _e389 = second;
    let _e390 = shift_2;
    let _e393 = fragment_smooth_inverse_depth((_e388 + (_e389 * _e390)));
    third = _e393;
    let _e395 = second;
    let _e396 = met_2;
    first_step = (_e395 - _e396);
    let _e399 = third;
    let _e400 = second;
    second_step = (_e399 - _e400);
    let _e403 = second_step;
    let _e406 = first_step;
    converges = (abs(_e403) < (0.5f * abs(_e406)));
    let _e411 = converges;
    if _e411 {
        let _e412 = third;
        let _e413 = second_step;
        let _e414 = second_step;
        let _e416 = first_step;
        let _e417 = second_step;
        local_12 = (_e412 + ((_e413 * _e414) / (_e416 - _e417)));
    } else {
        let _e421 = third;
        local_12 = _e421;
    }
    let _e423 = local_12;
    limit = _e423;
    let _e425 = meets;
    let _e426 = limit;
    let _e427 = met_2;
    let _e430 = px_per_inverse_depth;
    stays = (_e425 && ((abs((_e426 - _e427)) * _e430) < 1.5f));
    let _e436 = never_enters;
    let _e437 = meets;
    let _e439 = in_front;
    let _e441 = far_end;
    let _e442 = last_1;
    is_outside = (_e436 || ((!(_e437) && _e439) && (_e441 > _e442)));
    let _e447 = stays;
    if _e447 {
        let _e448 = limit;
        local_13 = _e448;
    } else {
        let _e449 = met_2;
        local_13 = _e449;
    }
    let _e451 = local_13;
    met_2 = _e451;
    let _e452 = is_outside;
    if _e452 {
        local_14 = vec2(-8f);
    } else {
        let _e456 = at_infinity_2;
        let _e457 = met_2;
        let _e458 = shift_2;
        local_14 = (_e456 + (_e457 * _e458));
    }
    let _e462 = local_14;
    (*pixel_8) = _e462;
    let _e463 = meets;
    if _e463 {
        let _e464 = met_2;
        local_15 = _e464;
    } else {
        let _e465 = (*pixel_8);
        let _e466 = fragment_inverse_depth_at(_e465);
        local_15 = _e466;
    }
    let _e468 = local_15;
    (*seen_there) = _e468;
    let _e470 = one_px;
    (*half_px_4) = (0.5f * _e470);
    let _e472 = meets;
    if _e472 {
        local_16 = 0i;
    } else {
        local_16 = 1i;
    }
    let _e476 = local_16;
    return _e476;
}

fn fragment_missed_by_triangles(channel_1: i32) -> vec2<f32> {
    var channel_2: i32;
    var place_5: vec2<f32> = vec2<f32>(0f, 0f);
    var share_1: vec2<f32>;
    var local_17: f32;
    var mixed: f32;

    channel_2 = channel_1;
    let _e57 = place_5;
    let _e59 = place_5;
    share_1 = (_e57 * (vec2(1f) - _e59));
    let _e64 = place_5;
    let _e66 = place_5;
    if ((_e64.x + _e66.y) < 1f) {
        let _e71 = place_5;
        let _e73 = place_5;
        local_17 = (_e71.x * _e73.y);
    } else {
        let _e77 = place_5;
        let _e81 = place_5;
        local_17 = ((1f - _e77.x) * (1f - _e81.y));
    }
    let _e86 = local_17;
    mixed = _e86;
    let _e88 = mixed;
    let _e89 = channel_2;
    let _e91 = fragment_mixed_bend[_e89];
    let _e94 = share_1;
    let _e96 = channel_2;
    let _e98 = fragment_bend[_e96];
    let _e101 = share_1;
    let _e103 = channel_2;
    let _e105 = fragment_bend[_e103];
    return ((_e88 * _e91) - (0.5f * ((_e94.x * _e98.xy) + (_e101.y * _e105.zw))));
}

fn fragment_light_at(pixel_9: vec2<f32>, inverse: f32, half_px_5: f32) -> vec4<f32> {
    var pixel_10: vec2<f32>;
    var inverse_1: f32;
    var half_px_6: f32;
    var local_18: vec2<f32>;
    var place_6: vec2<f32>;

    pixel_10 = pixel_9;
    inverse_1 = inverse;
    half_px_6 = half_px_5;
    let _e51 = fragment_is_direct;
    if _e51 {
        let _e52 = pixel_10;
        local_18 = _e52;
    } else {
        let _e53 = pixel_10;
        let _e54 = inverse_1;
        let _e55 = half_px_6;
        let _e56 = fragment_place_on_surface(_e53, _e54, _e55);
        local_18 = _e56;
    }
    let _e58 = local_18;
    place_6 = _e58;
    let _e60 = place_6;
    let _e61 = fragment_per_texel;
    let _e63 = fragment_sampled(fragment_picture, (_e60 * _e61));
    return _e63;
}

fn fragment_filtered_light(pixel_11: vec2<f32>, across_1: vec2<f32>, down_1: vec2<f32>, inverse_2: f32, half_px_7: f32) -> vec4<f32> {
    var pixel_12: vec2<f32>;
    var across_2: vec2<f32>;
    var down_2: vec2<f32>;
    var inverse_3: f32;
    var half_px_8: f32;
    var sum: vec4<f32> = vec4(0f);
    var i: f32 = 0f;
    var count: f32;
    var row_1: f32;
    var place_7: vec2<f32>;

    pixel_12 = pixel_11;
    across_2 = across_1;
    down_2 = down_1;
    inverse_3 = inverse_2;
    half_px_8 = half_px_7;
    let _e60 = fragment_samples_per_axis;
    let _e61 = fragment_samples_per_axis;
    count = (_e60 * _e61);
    loop {
        {
            let _e64 = i;
            let _e67 = fragment_samples_per_axis;
            row_1 = floor(((_e64 + 0.5f) / _e67));
            let _e71 = i;
            let _e72 = row_1;
            let _e73 = fragment_samples_per_axis;
            let _e76 = row_1;
            let _e81 = fragment_samples_per_axis;
            place_7 = (((vec2<f32>((_e71 - (_e72 * _e73)), _e76) + vec2(0.5f)) / vec2(_e81)) - vec2(0.5f));
            let _e88 = sum;
            let _e89 = pixel_12;
            let _e90 = place_7;
            let _e92 = across_2;
            let _e95 = place_7;
            let _e97 = down_2;
            let _e100 = inverse_3;
            let _e101 = half_px_8;
            let _e102 = fragment_light_at(((_e89 + (_e90.x * _e92)) + (_e95.y * _e97)), _e100, _e101);
            sum = (_e88 + _e102);
            let _e104 = i;
            i = (_e104 + 1f);
        }
        let _e107 = i;
        let _e108 = count;
        if !((_e107 < _e108)) {
            break;
        }
    }
    let _e111 = sum;
    let _e112 = count;
    return (_e111 / vec4(_e112));
}

fn fragment_code_of(light: vec3<f32>) -> vec3<f32> {
    var light_1: vec3<f32>;

    light_1 = light;
    let _e47 = light_1;
    return _e47;
}

fn fragment_add_channel(channel_3: i32) {
    var lost: bool;
    var local_19: vec2<f32>;
    var at_infinity_3: vec2<f32>;
    var local_20: vec2<f32>;
    var shift_3: vec2<f32>;
    var pixel_13: vec2<f32>;
    var inverse_4: f32 = 0f;
    var half_px_9: f32 = 0f;
    var status: i32 = 0i;
    var nearby: vec2<f32>;
    var local_21: vec2<f32>;
    var local_22: i32;
    var local_23: f32;
    var margin: f32;
    var inside: bool;
    var local_24: i32;
    var local_25: i32;
    var found: bool;
    var across_3: vec2<f32>;
    var down_3: vec2<f32>;
    var light_there: vec4<f32>;
    var local_26: vec3<f32>;
    var share_2: vec3<f32>;
    var local_27: vec4<f32>;
    var seen_1: vec4<f32>;
    var local_28: f32;
    var local_29: vec2<f32>;
    var local_30: vec2<f32>;

    let _e51 = fragment_known[channel_3];
    lost = (_e51 == 0f);
    let _e55 = lost;
    if _e55 {
        local_19 = vec2(0f);
    } else {
        let _e59 = fragment_path[channel_3];
        let _e61 = fragment_missed_by_triangles(channel_3);
        local_19 = (_e59.xy + _e61);
    }
    let _e64 = local_19;
    at_infinity_3 = _e64;
    let _e66 = lost;
    if _e66 {
        local_20 = vec2(0f);
    } else {
        let _e70 = fragment_path[channel_3];
        local_20 = _e70.zw;
    }
    let _e73 = local_20;
    shift_3 = _e73;
    let _e82 = fragment_is_direct;
    if _e82 {
        {
            let _e83 = at_infinity_3;
            let _e85 = fragment_range_2;
            let _e87 = fragment_range_2;
            let _e91 = shift_3;
            nearby = (_e83 + ((0.5f * (_e85.x + _e87.y)) * _e91));
            let _e95 = at_infinity_3;
            let _e96 = nearby;
            let _e97 = fragment_inverse_depth_at(_e96);
            let _e98 = shift_3;
            pixel_13 = (_e95 + (_e97 * _e98));
        }
    } else {
        {
            let _e101 = at_infinity_3;
            let _e102 = shift_3;
            if fragment_is_needed {
                let _e103 = fragment_range_2;
                local_21 = _e103;
            } else {
                let _e104 = fragment_range_2;
                local_21 = _e104.xx;
            }
            let _e107 = local_21;
            let _e114 = fragment_march(_e101, _e102, _e107, (&pixel_13), (&inverse_4), (&half_px_9));
            status = _e114;
            let _e115 = inverse_4;
            if (_e115 > fragment_nearest_shown) {
                local_22 = 1i;
            } else {
                let _e118 = status;
                local_22 = _e118;
            }
            let _e120 = local_22;
            status = _e120;
        }
    }
    if fragment_is_inset {
        local_23 = 0.5f;
    } else {
        local_23 = 0f;
    }
    let _e124 = local_23;
    margin = _e124;
    let _e126 = pixel_13;
    let _e127 = margin;
    let _e131 = pixel_13;
    let _e132 = fragment_size_px;
    let _e133 = margin;
    inside = (all((_e126 >= vec2(_e127))) && all((_e131 <= (_e132 - vec2(_e133)))));
    let _e140 = inside;
    inside = (_e140 || false);
    let _e145 = lost;
    if _e145 {
        local_25 = 3i;
    } else {
        let _e147 = inside;
        if _e147 {
            let _e148 = status;
            local_24 = _e148;
        } else {
            local_24 = 2i;
        }
        let _e151 = local_24;
        local_25 = _e151;
    }
    let _e153 = local_25;
    status = _e153;
    let _e154 = status;
    found = (_e154 <= 1i);
    fragment_sides_of_pixel(channel_3, (&across_3), (&down_3));
    let _e164 = pixel_13;
    let _e165 = across_3;
    let _e166 = down_3;
    let _e167 = inverse_4;
    let _e168 = half_px_9;
    let _e169 = fragment_filtered_light(_e164, _e165, _e166, _e167, _e168);
    light_there = _e169;
    if true {
        local_26 = vec3(1f);
    } else {
        local_26 = select(vec3(0f), vec3(1f), (vec3<i32>(0i, 1i, 2i) == vec3(channel_3)));
    }
    let _e188 = local_26;
    share_2 = _e188;
    let _e190 = found;
    if _e190 {
        let _e191 = light_there;
        let _e192 = _e191.xyz;
        let _e193 = light_there;
        let _e195 = fragment_global.opaque;
        local_27 = vec4<f32>(_e192.x, _e192.y, _e192.z, max(_e193.w, _e195));
    } else {
        let _e201 = fragment_global.background;
        let _e202 = fragment_global.opaque;
        local_27 = vec4<f32>(_e201.x, _e201.y, _e201.z, _e202);
    }
    let _e208 = local_27;
    seen_1 = _e208;
    let _e210 = fragment_light_2;
    let _e211 = share_2;
    let _e212 = seen_1;
    fragment_light_2 = (_e210 + (_e211 * _e212.xyz));
    if (channel_3 == 0i) {
        let _e220 = seen_1;
        local_28 = _e220.w;
    } else {
        let _e222 = fragment_alpha;
        local_28 = _e222;
    }
    let _e224 = local_28;
    fragment_alpha = _e224;
    let _e225 = fragment_worst;
    let _e226 = status;
    fragment_worst = max(_e225, _e226);
    if (channel_3 == 0i) {
        let _e232 = found;
        if _e232 {
            let _e233 = pixel_13;
            local_29 = _e233;
        } else {
            local_29 = vec2(-1f);
        }
        let _e238 = local_29;
        local_30 = _e238;
    } else {
        let _e239 = fragment_seen_at;
        local_30 = _e239;
    }
    let _e241 = local_30;
    fragment_seen_at = _e241;
    return;
}

fn fragment_shade() -> bool {
    var local_31: vec2<f32>;
    var local_32: bool;

    let _e49 = fragment_size_of(fragment_picture);
    fragment_size_px = vec2<f32>(_e49);
    let _e52 = fragment_size_px;
    fragment_per_texel = (vec2(1f) / _e52);
    fragment_add_channel(0i);
    if fragment_is_inset {
        let _e56 = fragment_seen_at;
        local_31 = ((_e56 * vec2<f32>(1f, 1f)) + vec2<f32>(0f, 0f));
    } else {
        let _e71 = fragment_seen_at;
        local_31 = _e71;
    }
    let _e73 = local_31;
    fragment_seen_at = _e73;
    let _e74 = fragment_light_2;
    let _e75 = fragment_code_of(_e74);
    fragment_light_2 = _e75;
    if fragment_is_backdrop {
        let _e76 = fragment_worst;
        local_32 = (fragment_is_needed && (_e76 == 0i));
    } else {
        let _e82 = fragment_worst;
        local_32 = (true || (_e82 <= 1i));
    }
    let _e87 = local_32;
    return _e87;
}

fn fragment_main_1() {
    var at_infinity_4: vec2<f32>;
    var shift_4: vec2<f32>;
    var forwards_1: bool;
    var local_33: f32;

    let _e51 = fragment_ray_3;
    let _e54 = fragment_global.image_from_ray[0];
    let _e57 = fragment_global.image_from_ray[1];
    let _e60 = fragment_global.image_from_ray[2];
    let _e65 = fragment_project_ray(_e51, _e54, _e57, _e60, (&at_infinity_4), (&shift_4));
    forwards_1 = _e65;
    let _e69 = forwards_1;
    let _e70 = fragment_has_ray_1;
    if (_e69 && (_e70 > 0.999f)) {
        local_33 = 1f;
    } else {
        local_33 = 0f;
    }
    let _e77 = local_33;
    fragment_known[0i] = _e77;
    let _e80 = at_infinity_4;
    let _e81 = shift_4;
    fragment_path[0i] = vec4<f32>(_e80.x, _e80.y, _e81.x, _e81.y);
    fragment_bend[0i] = vec4(0f);
    fragment_mixed_bend[0i] = vec2(0f);
    let _e95 = at_infinity_4;
    let _e96 = dpdx(_e95);
    let _e97 = at_infinity_4;
    let _e98 = dpdy(_e97);
    fragment_sides = vec4<f32>(_e96.x, _e96.y, _e98.x, _e98.y);
    let _e104 = fragment_sides;
    let _e105 = _e104.xy;
    let _e106 = fragment_sides;
    let _e107 = _e106.zw;
    let _e115 = fragment_largest_stretch(mat2x2<f32>(vec2<f32>(_e105.x, _e105.y), vec2<f32>(_e107.x, _e107.y)));
    let _e120 = fragment_global.most_samples_per_axis;
    fragment_samples_per_axis = clamp(ceil((_e115 / 1.25f)), 1f, _e120);
    let _e123 = fragment_global.nearest;
    fragment_range_2 = vec2<f32>(0f, _e123);
    let _e125 = shift_4;
    let _e127 = fragment_global.nearest;
    fragment_is_direct = ((length(_e125) * _e127) <= 0.05f);
    let _e131 = fragment_shade();
    let _e132 = fragment_light_2;
    let _e133 = fragment_alpha;
    fragment_colour = vec4<f32>(_e132.x, _e132.y, _e132.z, _e133);
    return;
}

@fragment
fn fragment(@location(0) ray: vec4<f32>, @location(1) has_ray: f32) -> fragment_FragmentOutput {
    fragment_ray_3 = ray;
    fragment_has_ray_1 = has_ray;
    fragment_main_1();
    let _e93 = fragment_colour;
    return fragment_FragmentOutput(_e93);
}
