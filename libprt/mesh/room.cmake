pkg_check_modules(CJSON REQUIRED IMPORTED_TARGET libcjson)
find_library(MESHOPTIMIZER_LIBRARY meshoptimizer REQUIRED)
find_library(DRACO_LIBRARY draco REQUIRED)
find_library(TINYGLTF_LIBRARY tinygltf REQUIRED)
target_sources(prt_mesh PRIVATE ${CMAKE_CURRENT_LIST_DIR}/shim_tinygltf.cpp)
# tinygltf before draco: Debian's libdraco exports an older tinygltf of its own under the same
# names, whose classes have another layout.
target_link_libraries(prt_mesh PRIVATE ${TINYGLTF_LIBRARY} PkgConfig::CJSON
  ${MESHOPTIMIZER_LIBRARY} ${DRACO_LIBRARY} prt_formats)
