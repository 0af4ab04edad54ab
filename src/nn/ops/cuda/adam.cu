// Elementwise updates of parameters, and the norm of gradients.

// One step of Adam, in place. The rests are 1 - beta, which is no longer exact when it is taken in single precision.
KERNEL void adam(float *parameter, float *first, float *second, const float *grad, unsigned n, float grad_scale, float beta1, float rest1,
                 float beta2, float rest2, float epsilon, float step_size, float second_correction) {
    size_t i = (size_t)blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= n) {
        return;
    }
    float g = grad[i] * grad_scale;
    first[i] = beta1 * first[i] + rest1 * g;
    second[i] = beta2 * second[i] + rest2 * g * g;
    parameter[i] -= step_size * first[i] / (sqrtf(second[i] * second_correction) + epsilon);
}

// average = decay average + rest value, in place.
KERNEL void average(float *average, const float *value, unsigned n, float decay, float rest) {
    size_t i = (size_t)blockIdx.x * blockDim.x + threadIdx.x;
    if (i < n) {
        average[i] = decay * average[i] + rest * value[i];
    }
}

// Sums of the squares of n_entries entries a block, one partial sum a block.
KERNEL void sums_of_squares(const float *x, unsigned n, unsigned n_entries, float *sums) {
    SHARED(parts);
    unsigned end = min(n, (blockIdx.x + 1) * n_entries);
    float sum = 0.0f;
    for (unsigned i = blockIdx.x * n_entries + threadIdx.x; i < end; i += blockDim.x) {
        sum += x[i] * x[i];
    }
    sum = warp_sum(sum);
    if (threadIdx.x % WARP == 0) {
        parts[threadIdx.x / WARP] = sum;
    }
    __syncthreads();
    if (threadIdx.x == 0) {
        for (unsigned warp = 1; warp < blockDim.x / WARP; warp++) {
            sum += parts[warp];
        }
        sums[blockIdx.x] = sum;
    }
}
