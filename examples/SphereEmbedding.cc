// The sphere embedding of Schmidt et al. 2023 as a program: SphereEmbedding mesh.obj sphere.obj
//
// Reads lines `v x y z` and `f a b c`, embeds by their library with its default settings, and
// writes one line `v x y z` for every vertex, in the order of the mesh, with all digits of a double.
// How to build it: docs/methods.md, programs of other authors.

#include <algorithm>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <string>

#include <SurfaceMaps/MultiRes/MultiResSphereEmbedding.hh>

namespace {

bool read(const char* path, SurfaceMaps::TriMesh& mesh) {
    std::ifstream file(path);
    for (std::string line; std::getline(file, line);) {
        std::istringstream words(line);
        std::string kind;
        words >> kind;
        if (kind == "v") {
            double x, y, z;
            if (!(words >> x >> y >> z)) return false;
            mesh.add_vertex({x, y, z});
        } else if (kind == "f") {
            int a, b, c;
            if (!(words >> a >> b >> c)) return false;
            const int least = std::min({a, b, c}), most = std::max({a, b, c});
            if (least < 1 || most > static_cast<int>(mesh.n_vertices())) return false;
            const auto corner = [](int index) { return OpenMesh::VertexHandle(index - 1); };
            if (!mesh.add_face(corner(a), corner(b), corner(c)).is_valid()) return false;
        }
    }
    return mesh.n_faces() > 0;
}

template <typename Positions>
void write(const char* path, const SurfaceMaps::TriMesh& mesh, const Positions& sphere) {
    std::ofstream file(path);
    file << std::setprecision(std::numeric_limits<double>::max_digits10);
    for (const auto vertex : mesh.vertices()) {
        const auto& p = sphere[vertex];
        file << "v " << p[0] << ' ' << p[1] << ' ' << p[2] << '\n';
    }
    if (!file.flush()) throw std::runtime_error(std::string(path) + ": cannot be written");
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 3) {
        std::cerr << "usage: SphereEmbedding mesh.obj sphere.obj\n";
        return 2;
    }
    SurfaceMaps::TriMesh mesh;
    if (!read(argv[1], mesh)) {
        std::cerr << argv[1] << ": not a mesh of lines `v x y z` and `f a b c`\n";
        return 2;
    }
    try {
        write(argv[2], mesh, SurfaceMaps::multi_res_sphere_embedding(mesh));
    } catch (const std::exception& error) {
        std::cerr << error.what() << "\n";
        return 1;
    }
    return 0;
}
