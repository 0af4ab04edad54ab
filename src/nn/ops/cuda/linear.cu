// What follows and precedes the matrix products of a linear map of rows (n, n_out): one thread a number.

// y = activation(product + bias), and exactly 0 where valid (n) is 0, unless all_valid. The product, and y, may be halved.
KERNEL void bias_activation(const void *product, const float *bias, const float *valid, unsigned n, unsigned n_out, unsigned relu,
                            unsigned all_valid, unsigned product_halved, unsigned y_halved, void *y) {
    size_t i = (size_t)blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= (size_t)n * n_out) {
        return;
    }
    float value = number_at(product, i, product_halved) + bias[i % n_out];
    if (relu) {
        value = fmaxf(value, 0.0f);
    }
    put_number(y, i, y_halved, all_valid || valid[i / n_out] != 0.0f ? value : 0.0f);
}

// The gradient before the activation, from grad at its result y: both, and what is written, halved or not.
KERNEL void bias_activation_backward(const void *y, const void *grad, const float *valid, unsigned n, unsigned n_out, unsigned relu,
                                     unsigned all_valid, unsigned halved, void *before) {
    size_t i = (size_t)blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= (size_t)n * n_out) {
        return;
    }
    int passes = (all_valid || valid[i / n_out] != 0.0f) && (!relu || number_at(y, i, halved) > 0.0f);
    put_number(before, i, halved, passes ? number_at(grad, i, halved) : 0.0f);
}
