#include "pipeline/clip_job.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "exporters/exporter.h"
#include "pipeline/certify.h"
#include "pipeline/file_io.h"
#include "pipeline/frame_replay.h"
#include "pipeline/map_file.h"
#include "pipeline/measure.h"
#include "pipeline/sheets.h"
#include "validation/contact_detection.h"

namespace limber {
namespace {

namespace fs = std::filesystem;

constexpr double kWarnGapPercent = 5.0;
constexpr double kWarnSlideExcess = 2.0;        // cm/s beyond the source's own
constexpr double kWarnPenetrationExcess = 1.0;  // cm
constexpr double kWarnMissed = 0.08;            // effector error over stature
constexpr double kMinConfidence = 0.6;

/// Import warnings that tell of something lost or invented; the others tell of a harmless repair.
bool tells_of_a_loss(const Warning& warning) {
  static const std::set<std::string, std::less<>> kLosses = {
      "bvh-partial-frame", "bvh-frame-count",  "fbx-layers",      "fbx-tangents",
      "mesh-invalid",      "scale-animated",   "scale-mirrored",  "scale-not-uniform",
      "scale-zero",        "unit-implausible", "weights-invalid", "weights-missing"};
  return kLosses.contains(warning.code);
}

/// The frames that --range names, at the rate the clip is retargeted at.
Result<void> set_range(const Clip& whole, const JobOptions& options, const Clip& resampled,
                       RetargetOptions& retarget) {
  if (!options.range) return {};
  const auto [first, last] = *options.range;
  if (first < 0 || last < first || first >= whole.frames()) {
    return Error{.code = "range-empty",
                 .message = fmt::format("the clip has the frames 0 to {}", whole.frames() - 1),
                 .hint = "give --range FIRST:LAST within the clip"};
  }
  const double ratio = resampled.rate_hz / whole.rate_hz;
  const std::int64_t end = resampled.frames() - 1;
  retarget.range = {
      std::min(static_cast<std::int64_t>(std::ceil(double(first) * ratio - 1e-6)), end),
      std::min(static_cast<std::int64_t>(std::floor(double(last) * ratio + 1e-6)), end)};
  if (retarget.range->first > retarget.range->second) {
    return Error{.code = "range-empty",
                 .message = "no frame of the output rate lies within the range",
                 .hint = "give a longer --range or a higher --rate"};
  }
  return {};
}

/// The same frames of the source, to be measured and drawn beside the result.
Clip cut(const Clip& clip, const std::pair<std::int64_t, std::int64_t>& range) {
  Clip out = clip;
  out.parent_from_joint.assign(clip.parent_from_joint.begin() + range.first * clip.joints,
                               clip.parent_from_joint.begin() + (range.second + 1) * clip.joints);
  return out;
}

/// One clip from its first guess to its report.
class ClipJob {
 public:
  ClipJob(const Source& source, const Clip& clip, std::string stem, const Target& target,
          const JobOptions& options)
      : source_(source), whole_(clip), stem_(std::move(stem)), target_(target), options_(options) {}

  ClipSummary run() {
    record_.source_path = source_.path;
    record_.source_sha256 = source_.sha256;
    record_.source_clip = whole_.name;
    record_.source = source_.imported.facts;
    record_.source->rate_hz = whole_.rate_hz;
    if (source_.imported.clips.size() > 1) record_.source->frames = whole_.frames();
    record_.convention = source_.figure.convention;
    record_.source_figure = source_.figure;
    record_.source_skeleton = &source_.imported.character.skeleton;
    record_.target = &target_;
    record_.warnings = source_.imported.warnings;
    for (const Warning& w : target_.warnings) record_.warnings.push_back(w);
    for (const Warning& w : record_.warnings) {
      if (tells_of_a_loss(w)) record_.status = Status::warn;
    }
    if (auto r = work(); !r) {
      record_.status = Status::fail;
      record_.errors.push_back(in_file(r.error(), source_.path));
    }
    return finish();
  }

 private:
  Result<void> work() {
    if (source_.figure.confidence < kMinConfidence) return refuse_map();
    auto calibration = calibrate(source_.imported.character, source_.figure, options_.reference,
                                 source_.imported.reference_pose, &whole_);
    if (!calibration) return calibration.error();
    record_.source_calibration = std::move(*calibration);
    clip_ = options_.rate_hz ? resample(whole_, *options_.rate_hz) : whole_;
    RetargetOptions retarget = options_.retarget;
    if (auto r = set_range(whole_, options_, clip_, retarget); !r) return r;
    const SourceMotion motion{&source_.imported.character, &source_.figure,
                              &*record_.source_calibration, &clip_};
    auto result = retarget_clip(motion, target_, retarget);
    if (!result) return result.error();
    record_.result = std::move(*result);
    if (retarget.range) clip_ = cut(clip_, *retarget.range);
    if (auto r = validate(target_.character.skeleton, record_.result->clip); !r) return r;
    record_.metrics = measure(motion);
    if (auto r = make_files(); !r) return r;
    judge();
    if (auto r = make_sheet(motion); !r) return r;
    return publish();
  }

  /// The clip is refused, and the map that was found is written for the user to mend.
  Result<void> refuse_map() {
    const fs::path path = options_.output / (stem_ + ".map.json");
    const auto r =
        write_whole(path, map_json({source_.path, &source_.imported.character, &source_.figure},
                                   {target_.path, &target_.character, &target_.figure}));
    if (!r) return r;
    return Error{.code = "map-unsure",
                 .message = fmt::format("the skeleton was understood with confidence {:.2f} only",
                                        source_.figure.confidence),
                 .hint = "mend " + path.filename().string() + " and pass it with --map"};
  }

  MotionMetrics measure(const SourceMotion& motion) const {
    const SourceMotion output{&target_.character, &target_.figure, &target_.calibration,
                              &record_.result->clip};
    const EffectorTrack& track = record_.result->track;
    return measure_against({motion, track.ground_offset}, {output, track.floor_y}, track.scale);
  }

  Result<void> make_files() {
    for (const std::string& format : options_.formats) {
      std::vector<std::byte> bytes;
      if (format == "glb") {
        auto glb = export_glb(target_.character, record_.result->clip);
        if (!glb) return glb.error();
        bytes = std::move(*glb);
      } else {
        auto bvh = export_bvh(target_.character, record_.result->clip);
        if (!bvh) return bvh.error();
        const auto text = std::as_bytes(std::span(bvh->data(), bvh->size()));
        bytes.assign(text.begin(), text.end());
      }
      FileCheck check = certify(bytes, format, target_, *record_.result, options_.retarget.limits,
                                options_.sandbox);
      keep(format, std::move(bytes));
      check.path = record_.files.back().path;
      record_.checks.push_back(std::move(check));
    }
    return {};
  }

  /// Files wait in memory until the clip is judged: what can be seen in the folder is complete.
  void keep(const std::string& extension, std::vector<std::byte> bytes) {
    record_.files.push_back(
        {stem_ + "." + extension, sha256_hex(bytes), static_cast<std::int64_t>(bytes.size())});
    contents_.push_back(std::move(bytes));
  }

  Result<void> publish() {
    for (std::size_t i = 0; i < contents_.size(); ++i) {
      if (auto r = write_whole(options_.output / record_.files[i].path, contents_[i]); !r) return r;
    }
    return {};
  }

  Result<void> make_sheet(const SourceMotion& motion) {
    auto png = draw_clip_sheet(record_, motion, stem_);
    if (!png) return png.error();
    keep("png", std::move(*png));
    return {};
  }

  /// The verdict: a broken promise fails the clip, doubtful looks are a warning.
  void judge() {
    const auto warn = [&](std::string code, std::string message) {
      record_.warnings.push_back({std::move(code), std::move(message)});
      record_.status = std::max(record_.status, Status::warn);
    };
    const auto fail = [&](std::string code, std::string message, const FileCheck& check) {
      record_.errors.push_back(Error{.code = std::move(code),
                                     .message = std::move(message),
                                     .file = source_.path,
                                     .joint = check.worst_joint,
                                     .frame = check.worst_frame,
                                     .hint = "please report this clip"});
      record_.status = Status::fail;
    };
    for (const FileCheck& check : record_.checks) {
      if (check.violations > 0) {
        fail("limits-violated",
             fmt::format("{}: {} joint-frames beyond their limits, worst {:.4f} degrees",
                         check.path, check.violations, check.max_violation_deg),
             check);
      }
      if (!check.ok) {
        fail("certificate-failed",
             check.path + ": " + (check.faults.empty() ? "unreadable" : check.faults.front()),
             check);
      }
      if (!check.reason.empty()) {
        record_.warnings.push_back({"certificate-own-reader", check.path + ": " + check.reason});
      }
    }
    judge_gap();
    for (const Warning& w : record_.result->warnings) warn(w.code, w.message);
    if (const auto& refined = record_.result->refine.clip; refined && !refined->report.improved) {
      record_.warnings.push_back({"refine-kept",
                                  "the whole clip's optimum is no better than what "
                                  "the solver found; that was kept"});
    }
    const double missed = 1e-3 * percentile(record_.result->worst_error_mm, 95.0);
    if (target_.figure.is_body() && missed > kWarnMissed * target_.calibration.height) {
      warn("effectors-missed",
           fmt::format(
               "hands, feet or pelvis are {:.0f} mm from where they should be (95th percentile)",
               1e3 * missed));
    }
    if (!record_.metrics) return;
    const MotionMetrics& m = *record_.metrics;
    if (m.pops > 0) {
      warn("motion-pops", fmt::format("{} joint-frames jump where the source does not", m.pops));
      if (!m.pop_list.empty()) {
        record_.warnings.back().joint = m.pop_list.front().role;
        record_.warnings.back().frame = m.pop_list.front().frame;
      }
    }
    if (m.output.slide_cm_s > m.source.slide_cm_s + kWarnSlideExcess) {
      warn("feet-slide", fmt::format("feet slide {:.1f} cm/s, the source's {:.1f}",
                                     m.output.slide_cm_s, m.source.slide_cm_s));
    }
    if (m.output.penetration_cm > m.source.penetration_cm + kWarnPenetrationExcess) {
      warn("feet-sink", fmt::format("soles sink {:.1f} cm into the floor, the source's {:.1f}",
                                    m.output.penetration_cm, m.source.penetration_cm));
    }
  }

  /// Where Ceres found something clearly better, the frame can be solved again alone.
  void judge_gap() {
    const RefineFigures& refine = record_.result->refine;
    const auto worst = std::ranges::max_element(refine.gap_percent);
    if (worst == refine.gap_percent.end() || !(*worst > kWarnGapPercent)) return;
    const std::int64_t frame = refine.frames[worst - refine.gap_percent.begin()];
    const FrameReplay replay = replay_of(*record_.result, frame);
    for (const auto& [extension, text] :
         {std::pair("gap.rig.json", &replay.rig), std::pair("gap.targets.json", &replay.targets)}) {
      const auto bytes = std::as_bytes(std::span(text->data(), text->size()));
      keep(extension, {bytes.begin(), bytes.end()});
    }
    Warning warning{"solver-gap",
                    fmt::format("Ceres found a pose {:.1f} % better; replay it with `limber pose "
                                "{}.gap.rig.json --targets {}.gap.targets.json -o sheet.png`",
                                *worst, stem_, stem_)};
    warning.frame = frame;
    record_.warnings.push_back(std::move(warning));
    record_.status = std::max(record_.status, Status::warn);
  }

  /// What the user asks of the figures that the report would show.
  void pass_gates() {
    if (!options_.gates || !record_.result) return;
    record_.gates = judge_gates(*options_.gates, report_json(record_));
    for (const GateVerdict& gate : record_.gates) {
      if (gate.level == GateLevel::warn) {
        record_.warnings.push_back({"gate-warned", describe(gate)});
        record_.status = std::max(record_.status, Status::warn);
      } else if (gate.level == GateLevel::fail) {
        record_.errors.push_back(Error{.code = "gate-missed",
                                       .message = describe(gate),
                                       .file = source_.path,
                                       .hint = "look at the sheet; the gates are yours to set"});
        record_.status = Status::fail;
      }
    }
  }

  ClipSummary finish() {
    pass_gates();
    ClipSummary summary{.source = source_.path,
                        .clip = whole_.name,
                        .stem = stem_,
                        .status = record_.status,
                        .code = "",
                        .message = ""};
    if (record_.result) {
      summary.frames = record_.result->clip.frames();
      summary.error_p95_mm = percentile(record_.result->worst_error_mm, 95.0);
      summary.violations = worst_of(record_.checks).violations;
    }
    if (auto r = write_whole(options_.output / (stem_ + ".report.json"), report_json(record_));
        !r) {
      record_.errors.push_back(r.error());
      summary.status = Status::fail;
    }
    for (const Error& error : record_.errors) {
      if (error.code == "output-unwritable") summary.unwritten = error.message;
    }
    if (!record_.errors.empty()) {
      summary.code = record_.errors.front().code;
      summary.message = record_.errors.front().message;
    } else if (record_.status == Status::warn && !record_.warnings.empty()) {
      summary.code = record_.warnings.back().code;
      summary.message = record_.warnings.back().message;
    }
    return summary;
  }

  const Source& source_;
  const Clip& whole_;
  std::string stem_;
  const Target& target_;
  const JobOptions& options_;
  Clip clip_;
  ClipRecord record_;
  std::vector<std::vector<std::byte>> contents_;  // of record_.files
};

}  // namespace

Error in_file(Error error, const std::string& path) {
  if (error.file.empty()) error.file = path;
  return error;
}

ClipSummary run_clip(const Source& source, const Clip& clip, const std::string& stem,
                     const Target& target, const JobOptions& options) {
  return ClipJob(source, clip, stem, target, options).run();
}

}  // namespace limber
