// What all kernels share. The files are written in the subset of CUDA that is also C, so that a C compiler can build them for tests
// on machines without a GPU (emulator.c); KERNEL stands for what makes a function a kernel.
//
// Matrices are row-major. Sums are taken in a fixed order, without atomic additions: the same input gives the same bytes.

#ifndef KERNEL
#define KERNEL extern "C" __global__
#define DEVICE static __device__ __forceinline__
// Shared memory of a block, as many numbers as the launch asks for.
#define SHARED(name) extern __shared__ float name[]
#endif

#define WARP 32

// Number i of x: of floats, or of bf16 (the upper half of a float) where halved.
DEVICE float number_at(const void *x, size_t i, unsigned halved) {
    return halved ? __uint_as_float((unsigned)((const unsigned short *)x)[i] << 16) : ((const float *)x)[i];
}

// Writes it. Halved, it becomes the nearest bf16, the even one of two.
DEVICE void put_number(void *x, size_t i, unsigned halved, float value) {
    if (!halved) {
        ((float *)x)[i] = value;
        return;
    }
    unsigned bits = __float_as_uint(value);
    unsigned short nearest = (unsigned short)((bits + 0x7fffu + (bits >> 16 & 1u)) >> 16);
    ((unsigned short *)x)[i] = value == value ? nearest : 0x7fc0;
}

// The sum of x over the threads of a warp, in all of them.
DEVICE float warp_sum(float x) {
    for (int apart = WARP / 2; apart > 0; apart /= 2) {
        x += __shfl_xor_sync(0xffffffffu, x, apart);
    }
    return x;
}

// Sums over rows of the columns of m (n, dim), whose numbers may be halved. Block (c, k) of gridDim.y = ceil(dim / 32) by gridDim.x adds the rows from
// k * n_rows to (k + 1) * n_rows - 1 of 32 columns into row k of sums (gridDim.x, dim).
KERNEL void column_sums(const void *m, unsigned halved, unsigned n, unsigned dim, unsigned n_rows, float *sums) {
    SHARED(parts);
    unsigned column = blockIdx.y * WARP + threadIdx.x % WARP, n_warps = blockDim.x / WARP;
    unsigned end = min(n, (blockIdx.x + 1) * n_rows);
    float sum = 0.0f;
    if (column < dim) {
        for (unsigned row = blockIdx.x * n_rows + threadIdx.x / WARP; row < end; row += n_warps) {
            sum += number_at(m, (size_t)row * dim + column, halved);
        }
    }
    parts[threadIdx.x] = sum;
    __syncthreads();
    if (threadIdx.x < WARP && column < dim) {
        for (unsigned warp = 1; warp < n_warps; warp++) {
            sum += parts[warp * WARP + threadIdx.x];
        }
        sums[(size_t)blockIdx.x * dim + column] = sum;
    }
}
