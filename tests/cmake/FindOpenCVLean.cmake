# The lean Debian packages libopencv-core-dev and libopencv-imgproc-dev bring no CMake config.
# Gives the imported targets OpenCVLean::core and OpenCVLean::imgproc; their headers are SYSTEM.
find_path(OpenCVLean_INCLUDE_DIR opencv2/imgproc.hpp PATH_SUFFIXES opencv4)
find_library(OpenCVLean_CORE_LIBRARY opencv_core)
find_library(OpenCVLean_IMGPROC_LIBRARY opencv_imgproc)

include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(OpenCVLean REQUIRED_VARS
  OpenCVLean_CORE_LIBRARY OpenCVLean_IMGPROC_LIBRARY OpenCVLean_INCLUDE_DIR)

if(OpenCVLean_FOUND AND NOT TARGET OpenCVLean::core)
  add_library(OpenCVLean::core UNKNOWN IMPORTED)
  set_target_properties(OpenCVLean::core PROPERTIES
    IMPORTED_LOCATION ${OpenCVLean_CORE_LIBRARY}
    INTERFACE_SYSTEM_INCLUDE_DIRECTORIES ${OpenCVLean_INCLUDE_DIR}
    INTERFACE_INCLUDE_DIRECTORIES ${OpenCVLean_INCLUDE_DIR})
  add_library(OpenCVLean::imgproc UNKNOWN IMPORTED)
  set_target_properties(OpenCVLean::imgproc PROPERTIES
    IMPORTED_LOCATION ${OpenCVLean_IMGPROC_LIBRARY}
    INTERFACE_LINK_LIBRARIES OpenCVLean::core)
endif()
mark_as_advanced(OpenCVLean_INCLUDE_DIR OpenCVLean_CORE_LIBRARY OpenCVLean_IMGPROC_LIBRARY)
