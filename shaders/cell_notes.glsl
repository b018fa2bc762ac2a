// Bounds of a cell with notes, as cells.frag writes them.

const float COVERED = 2.0 * MISSING;  // range of a cell that the next sharper picture fills
const int STEP = 14;  // step of binary exponents, larger than the exponent of any inverse depth

// Bounds of a cell, together with the samples of its display pixels along each axis, 1 to MOST_SAMPLES = 4, and whether
// an inset fills it: unchanged for 1 sample and no inset, else negative, with a scale that encodes the notes.
vec2 with_notes(vec2 range, float samples, bool is_filled)
{
    int notes = int(clamp(samples, 1.0, MOST_SAMPLES)) - 1 + (is_filled ? 4 : 0);
    return notes == 0 ? range : -ldexp(1.0 + range, ivec2(STEP * (notes - 1)));
}

vec2 without_notes(vec2 range, out float samples, out bool is_filled)
{
    int notes = range.x < 0.0 ? int((log2(-range.x) + 0.01) / float(STEP)) + 1 : 0;
    samples = float(notes % 4 + 1);
    is_filled = notes >= 4;
    return notes == 0 ? range : -1.0 - ldexp(range, ivec2(STEP * (1 - notes)));
}
