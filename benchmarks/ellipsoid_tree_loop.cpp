// A loop around ellipsoid-tree's test of a box and an ellipsoid, its objects ready-made.
// The box is aligned with the axes there: pairs come in box coordinates.

#include <ellipsoid_tree/intersections.hpp>

#include <cstdint>
#include <vector>

using namespace ellipsoid_tree;

struct Pairs {
    std::vector<Box> boxes;
    std::vector<Ellipsoid> ellipsoids;
};

// k, e (n, 3) and S (n, 3, 3): centres, half extents and shape matrices.
extern "C" Pairs* make(ptrdiff_t n, const double* k, const double* e, const double* S) {
    auto* pairs = new Pairs;
    for (ptrdiff_t p = 0; p < n; p++) {
        Eigen::VectorXd half = Eigen::Map<const Eigen::Vector3d>(e + 3 * p);
        Eigen::VectorXd center = Eigen::Map<const Eigen::Vector3d>(k + 3 * p);
        Eigen::MatrixXd shape = Eigen::Map<const Eigen::Matrix3d>(S + 9 * p);
        pairs->boxes.push_back(Box{-half, half});
        pairs->ellipsoids.push_back(Ellipsoid{center, shape});
    }
    return pairs;
}

extern "C" void overlaps(const Pairs* pairs, uint8_t* out) {
    const size_t n = pairs->boxes.size();
    for (size_t p = 0; p < n; p++)
        out[p] = intersects(pairs->boxes[p], pairs->ellipsoids[p], 1.0);
}

extern "C" void discard(Pairs* pairs) { delete pairs; }
