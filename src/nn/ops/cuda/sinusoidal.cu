// Sines, then cosines, of 2 pi f x: x (n) and f (n_frequencies) to (n, 2 n_frequencies). One thread a sine and its cosine.

// Cycles of the angle without whole turns, taken in double precision: x f is large and its digits behind the point matter. The
// frequency comes in two parts, because kernels take float alone.
DEVICE float cycles(float x, float high, float low) {
    double turns = (double)x * ((double)high + (double)low);
    return (float)(turns - rint(turns));
}

#define TAU 6.2831853071795865f

KERNEL void sinusoidal(const float *x, const float *high, const float *low, unsigned n, unsigned n_frequencies, float *y) {
    size_t i = (size_t)blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= (size_t)n * n_frequencies) {
        return;
    }
    size_t row = i / n_frequencies, f = i % n_frequencies;
    float angle = TAU * cycles(x[row], high[f], low[f]);
    y[row * 2 * n_frequencies + f] = sinf(angle);
    y[row * 2 * n_frequencies + n_frequencies + f] = cosf(angle);
}

// The gradient at x (n) from grad at the result y: one warp a number.
KERNEL void sinusoidal_backward(const float *y, const float *grad, const float *high, unsigned n, unsigned n_frequencies, float *dx) {
    unsigned row = (blockIdx.x * blockDim.x + threadIdx.x) / WARP, lane = threadIdx.x % WARP;
    if (row >= n) {
        return;
    }
    y += (size_t)row * 2 * n_frequencies;
    grad += (size_t)row * 2 * n_frequencies;
    float sum = 0.0f;
    for (unsigned f = lane; f < n_frequencies; f += WARP) {
        sum += TAU * high[f] * (grad[f] * y[n_frequencies + f] - grad[n_frequencies + f] * y[f]);
    }
    sum = warp_sum(sum);
    if (lane == 0) {
        dx[row] = sum;
    }
}
