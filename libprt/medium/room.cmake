# cJSON reads material files; LAPACKE and OpenBLAS give the radial bases.
pkg_check_modules(CJSON REQUIRED IMPORTED_TARGET libcjson)
pkg_check_modules(LAPACKE REQUIRED IMPORTED_TARGET lapacke openblas)
target_link_libraries(prt_medium PUBLIC PkgConfig::CJSON PkgConfig::LAPACKE)
