#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "assets/model/result.h"
#include "importers/importer.h"
#include "pipeline/figure.h"
#include "pipeline/gates.h"
#include "pipeline/retarget.h"
#include "pipeline/target.h"
#include "validation/motion_metrics.h"

namespace limber {

enum class Status : std::uint8_t { pass, warn, fail };
const char* to_string(Status);

struct OutputFile {
  std::string path;  ///< relative to the output folder
  std::string sha256;
  std::int64_t bytes = 0;
};

/// What reading a written file back showed.
struct FileCheck {
  std::string path;
  std::string reader;
  std::string reason;  ///< why not the reader that did not write it; empty otherwise
  bool ok = false;
  double joints_max_error_m = 0.0;
  std::vector<std::string> faults;
  std::int64_t limited_joints = 0;
  std::int64_t violations = 0;
  double max_violation_deg = 0.0;
  std::string worst_joint;  ///< with worst_frame, where there is a violation
  std::int64_t worst_frame = -1;
};

/// All checks of a clip as one: the worst of each figure; `ok` where there are checks and all are.
FileCheck worst_of(const std::vector<FileCheck>&);

/// Everything a clip's report says; parts that did not happen stay empty and are left out.
struct ClipRecord {
  Status status = Status::pass;
  std::vector<Error> errors;
  Warnings warnings;
  std::string source_path, source_sha256, source_clip, convention;
  std::optional<SourceFacts> source;
  std::optional<Calibration> source_calibration;
  const Target* target = nullptr;
  const Skeleton* source_skeleton = nullptr;
  std::optional<Figure> source_figure;
  std::vector<OutputFile> files;
  std::optional<Retargeted> result;
  std::optional<MotionMetrics> metrics;
  std::vector<FileCheck> checks;
  std::vector<GateVerdict> gates;
};

/// The clip's report: schema `limber-report/1` (assets/data/schemas), the same text on every run.
std::string report_json(const ClipRecord&);

/// One side of a map file.
struct MapSide {
  std::string path;
  const Character* character = nullptr;
  const Figure* figure = nullptr;  ///< null: nothing could be identified
};

/// A map, to be edited and given back with --map: format `limber-map/1`.
std::string map_json(const MapSide& source, const MapSide& target);

}  // namespace limber
