#include "importers/bvh_parser.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdlib>

#include "importers/failure.h"
#include "importers/plain_number.h"

namespace limber {

namespace {

constexpr std::size_t kMaxDepth = 1024;
constexpr std::size_t kMaxJoints = 65536;
constexpr std::size_t kMaxNameBytes = 255;
constexpr std::size_t kPassedBytes = std::size_t{16} << 20;  // between two reports of progress

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\v' || c == '\f'; }
bool is_eol(char c) { return c == '\n' || c == '\r'; }
bool is_space(char c) { return is_blank(c) || is_eol(c); }

char lower(char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; }

bool same_word(std::string_view a, std::string_view lower_case) {
  return a.size() == lower_case.size() && std::equal(a.begin(), a.end(), lower_case.begin(),
                                                     [](char x, char y) { return lower(x) == y; });
}

/// What to show of a token that nobody understands.
std::string shown(std::string_view token) {
  std::string text(token.substr(0, 24));
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) > 0x7E) c = '?';
  }
  return token.size() > 24 ? text + "..." : text;
}

class Parser {
 public:
  Parser(std::string_view text, const BvhRowSink& sink, const BvhPassed& passed)
      : text_(text), sink_(sink), on_passed_(passed) {}

  BvhDocument run() {
    read_hierarchy();
    read_motion();
    return std::move(document_);
  }

 private:
  // ---- words

  void skip_space() {
    while (at_ < text_.size() && is_space(text_[at_])) ++at_;
  }
  void skip_blanks() {
    while (at_ < text_.size() && is_blank(text_[at_])) ++at_;
  }

  /// The next word; braces and a colon stand alone. Empty at the end of the text.
  std::string_view next() {
    skip_space();
    const std::size_t begin = at_;
    const auto alone = [](char c) { return c == '{' || c == '}' || c == ':'; };
    if (at_ < text_.size() && alone(text_[at_])) return text_.substr(at_++, 1);
    while (at_ < text_.size() && !is_space(text_[at_]) && !alone(text_[at_])) ++at_;
    return text_.substr(begin, at_ - begin);
  }

  std::string_view peek() {
    const std::size_t here = at_;
    const std::string_view word = next();
    at_ = here;
    return word;
  }

  bool accept(std::string_view lower_case_word) {
    const std::size_t here = at_;
    if (same_word(next(), lower_case_word)) return true;
    at_ = here;
    return false;
  }

  void expect(std::string_view lower_case_word, const char* shown_as) {
    const std::string_view word = next();
    if (!same_word(word, lower_case_word)) {
      complain("bvh-syntax", fmt::format("expected {}, found {}", shown_as,
                                         word.empty() ? "the end of the file"
                                                      : fmt::format("'{}'", shown(word))));
    }
  }

  [[noreturn]] void complain(const char* code, const std::string& what,
                             const char* hint = "the file is damaged: export it again") {
    count_lines();
    fail(code, fmt::format("line {}: {}", line_, what), hint);
  }

  /// Brings `line_` from the last passed byte up to here.
  void count_lines() {
    for (std::size_t i = passed_; i < std::min(at_, text_.size()); ++i) {
      const bool crlf = text_[i] == '\r' && i + 1 < text_.size() && text_[i + 1] == '\n';
      if (is_eol(text_[i]) && !crlf) ++line_;
    }
  }

  void tell_passed() {
    if (at_ - passed_ < kPassedBytes || !on_passed_) return;
    count_lines();
    passed_ = at_;
    on_passed_(passed_);
  }

  /// A number at `at_`, which moves behind it; it must end at white space, a brace or the end.
  double read_number(const char* what) {
    const char* begin = text_.data() + at_;
    const char* const end = text_.data() + text_.size();
    if (begin != end && *begin == '+') ++begin;
    double value = 0.0;
    auto [stop, fault] = std::from_chars(begin, end, value);
    if (fault == std::errc::result_out_of_range) value = std::strtod(word_at(at_).c_str(), nullptr);
    const bool ended = stop == end || is_space(*stop) || *stop == '}' || *stop == '{';
    if (fault == std::errc::invalid_argument || !ended) {
      const std::string word = word_at(at_);
      if (word.find('#') != std::string::npos) return std::nan("");  // 1.#IND and its kin
      complain("bvh-number", fmt::format("{}: '{}' is no number", what, shown(word)),
               word.find(',') != std::string::npos
                   ? "numbers need a decimal point: export again with the English number format"
                   : "the file is damaged: export it again");
    }
    at_ = static_cast<std::size_t>(stop - text_.data());
    return value;
  }

  std::string word_at(std::size_t begin) const {
    std::size_t end = begin;
    while (end < text_.size() && !is_space(text_[end]) && end - begin < 512) ++end;
    return std::string(text_.substr(begin, end - begin));
  }

  // ---- hierarchy

  void read_hierarchy() {
    expect("hierarchy", "HIERARCHY");
    while (!accept("motion")) {
      if (stack_.empty()) {
        if (peek().empty()) {
          fail("bvh-no-motion", "the file ends before its MOTION section",
               "the file is cut short or holds a skeleton only: export it again with motion");
        }
        if (!accept("root")) expect("root", "ROOT or MOTION");
        open_joint(read_name(), false);
      } else {
        read_statement();
      }
    }
    if (!stack_.empty()) complain("bvh-syntax", "MOTION comes before the last '}'");
    if (document_.joints.empty()) complain("bvh-syntax", "the hierarchy has no ROOT");
    if (document_.columns == 0) complain("bvh-channels", "no joint has a channel");
  }

  void read_statement() {
    BvhJoint& joint = document_.joints[stack_.back()];
    if (accept("}")) {
      stack_.pop_back();
    } else if (accept("offset")) {
      for (int k = 0; k < 3; ++k) {
        skip_space();
        joint.offset[k] = read_number("OFFSET");
        if (!std::isfinite(joint.offset[k])) complain("bvh-nan", "OFFSET is not finite");
      }
    } else if (accept("channels")) {
      read_channels(joint);
    } else if (joint.end_site) {
      expect("}", "'}' after an End Site's OFFSET");
    } else if (accept("joint")) {
      open_joint(read_name(), false);
    } else if (accept("end")) {
      read_name();  // "Site", and whatever follows
      open_joint({}, true);
    } else {
      expect("}", "OFFSET, CHANNELS, JOINT, End Site or '}'");
    }
  }

  /// The rest of the line, which may hold spaces, up to a brace that opens the block.
  std::string read_name() {
    skip_blanks();
    const std::size_t begin = at_;
    while (at_ < text_.size() && !is_eol(text_[at_])) ++at_;
    std::size_t end = at_;
    const auto trim = [&] {
      while (end > begin && is_blank(text_[end - 1])) --end;
    };
    trim();
    const std::size_t brace = text_.substr(begin, end - begin).find('{');
    if (brace != std::string_view::npos) {
      end = at_ = begin + brace;
      trim();
    }
    if (end - begin > kMaxNameBytes) {
      document_.warnings.push_back(
          {"joint-renamed",
           fmt::format("a joint's name of {} bytes was cut to {}", end - begin, kMaxNameBytes)});
      end = begin + kMaxNameBytes;
    }
    return std::string(text_.substr(begin, end - begin));
  }

  void open_joint(std::string name, bool end_site) {
    if (document_.joints.size() >= kMaxJoints) {
      complain("bvh-size", fmt::format("more than {} joints", kMaxJoints));
    }
    if (stack_.size() >= kMaxDepth) {
      complain("bvh-depth", fmt::format("joints are nested deeper than {} levels", kMaxDepth));
    }
    expect("{", "'{'");
    BvhJoint joint;
    joint.name = std::move(name);
    joint.end_site = end_site;
    joint.parent = stack_.empty() ? -1 : static_cast<std::int32_t>(stack_.back());
    joint.channel_begin = document_.columns;
    stack_.push_back(document_.joints.size());
    document_.joints.push_back(std::move(joint));
  }

  void read_channels(BvhJoint& joint) {
    skip_space();
    const double count = read_number("CHANNELS");
    if (!(count >= 0 && count <= 6) || count != std::floor(count)) {
      complain("bvh-channels", fmt::format("CHANNELS {} is not within 0 to 6", count));
    }
    if (!joint.channels.empty()) complain("bvh-channels", "a second CHANNELS in one joint");
    if (stack_.back() + 1 != document_.joints.size()) {
      complain("bvh-channels", "CHANNELS stands after a child, so its columns are unclear");
    }
    if (joint.end_site && count > 0) complain("bvh-channels", "an End Site has channels");
    for (int k = 0; k < static_cast<int>(count); ++k) joint.channels.push_back(read_channel());
    document_.columns += joint.channels.size();
    check_repeats(joint);
  }

  BvhChannel read_channel() {
    const std::string_view word = next();
    const auto axis = word.empty() ? -1 : lower(word[0]) - 'x';
    if (axis >= 0 && axis < 3 && same_word(word.substr(1), "position")) return BvhChannel(axis);
    if (axis >= 0 && axis < 3 && same_word(word.substr(1), "rotation")) return BvhChannel(axis + 3);
    complain("bvh-channels", fmt::format("'{}' is no channel name", shown(word)),
             "a channel is Xposition, Yposition, Zposition, Xrotation, Yrotation or Zrotation");
  }

  /// The same rotation axis twice is odd but has one meaning (Z X Z); a position twice has none.
  void check_repeats(const BvhJoint& joint) {
    for (std::size_t a = 0; a < joint.channels.size(); ++a) {
      for (std::size_t b = a + 1; b < joint.channels.size(); ++b) {
        if (joint.channels[a] != joint.channels[b]) continue;
        if (!is_rotation(joint.channels[a])) {
          complain("bvh-channels", "a position channel is named twice");
        }
        document_.warnings.push_back({"bvh-repeated-axis",
                                      "a rotation axis is named twice; the rotations were applied "
                                      "in file order",
                                      joint.name});
        return;
      }
    }
  }

  // ---- motion

  void read_motion() {
    read_motion_header();
    const std::size_t columns = document_.columns;
    // A value takes at least a digit and a separator.
    const std::int64_t possible =
        static_cast<std::int64_t>((text_.size() - at_) / (2 * columns)) + 1;
    document_.expected_frames = std::min(document_.declared_frames, possible);
    row_.resize(columns);
    std::size_t in_row = 0;
    bool wrapped = false;
    while (true) {
      in_row = read_plain_values(in_row);
      skip_blanks();
      if (at_ == text_.size()) break;
      if (is_eol(text_[at_])) {
        if (in_row == columns) in_row = finish_row();
        wrapped = wrapped || in_row != 0;
        ++at_;
        continue;
      }
      if (in_row == columns) complain_long_row();
      row_[in_row] = read_number("motion");
      if (!std::isfinite(row_[in_row])) complain_not_finite(in_row);
      ++in_row;
    }
    finish_motion(in_row, wrapped);
  }

  /// Goes on with the row as long as its values are plain numbers between blanks, which nearly all
  /// are; returns how many it has then.
  std::size_t read_plain_values(std::size_t in_row) {
    const char* const end = text_.data() + text_.size();
    const char* at = text_.data() + at_;
    while (in_row < row_.size()) {
      while (at != end && is_blank(*at)) ++at;
      const char* const behind = read_plain_number(at, end, row_[in_row]);
      if (behind == nullptr || !is_space(*behind)) break;
      at = behind;
      ++in_row;
    }
    at_ = static_cast<std::size_t>(at - text_.data());
    return in_row;
  }

  /// Hands the row on; returns the number of values in the next one.
  std::size_t finish_row() {
    sink_(document_, row_);
    ++document_.frames;
    tell_passed();
    return 0;
  }

  void read_motion_header() {
    expect("frames", "Frames:");
    accept(":");
    skip_space();
    const double frames = read_number("Frames");
    if (!(frames >= 0 && frames < 9e15)) complain("bvh-syntax", "the number of frames is no count");
    document_.declared_frames = static_cast<std::int64_t>(frames);
    expect("frame", "Frame Time:");
    expect("time", "Frame Time:");
    accept(":");
    skip_space();
    document_.frame_time_text = word_at(at_);
    document_.frame_time_s = read_number("Frame Time");
    if (!(document_.frame_time_s > 0.0) || !std::isfinite(document_.frame_time_s)) {
      complain("bvh-frame-time",
               fmt::format("Frame Time is {}, not above zero", shown(document_.frame_time_text)),
               "write the seconds between two frames, such as 0.0333333");
    }
  }

  [[noreturn]] void complain_long_row() {
    complain("bvh-row-length",
             fmt::format("frame {} has more than the {} values that CHANNELS announce",
                         document_.frames, document_.columns),
             "the motion does not belong to this hierarchy: export the file again");
  }

  [[noreturn]] void complain_not_finite(std::size_t column) {
    Error error{.code = "bvh-nan",
                .message = "a motion value is not finite",
                .frame = document_.frames,
                .hint = "repair or cut the frame in the tool that wrote the file"};
    for (const BvhJoint& joint : document_.joints) {
      const bool holds =
          column >= joint.channel_begin && column < joint.channel_begin + joint.channels.size();
      if (holds) error.joint = joint.name;
    }
    throw Failure{std::move(error)};
  }

  void finish_motion(std::size_t in_row, bool wrapped) {
    const std::size_t columns = document_.columns;
    const bool cut = !text_.empty() && !is_space(text_.back());
    // Where frames are missing and the last line has no end, its last number may be cut as well.
    const bool whole =
        in_row == columns && !(cut && document_.frames + 1 < document_.declared_frames);
    if (whole) in_row = finish_row();
    const bool partial = in_row != 0;
    if (partial) {
      if (in_row != columns && document_.frames == 0) {
        complain("bvh-row-length",
                 fmt::format("frame 0 has {} values where CHANNELS announce {}", in_row, columns),
                 "the motion does not belong to this hierarchy: export the file again");
      }
      document_.warnings.push_back(
          {"bvh-partial-frame", "the last frame is cut off and was dropped", "", document_.frames});
    }
    if (wrapped) {
      document_.warnings.push_back({"bvh-wrapped-rows", "frames extend over several lines"});
    }
    if (document_.frames != document_.declared_frames) {
      document_.warnings.push_back(
          {"bvh-frame-count", fmt::format("the file announces {} frames and holds {}",
                                          document_.declared_frames, document_.frames)});
    }
  }

  std::string_view text_;
  const BvhRowSink& sink_;
  const BvhPassed& on_passed_;
  std::vector<double> row_;
  std::size_t at_ = 0;
  std::size_t passed_ = 0;  // nothing before it is read again
  std::int64_t line_ = 1;   // of `passed_`
  std::vector<std::size_t> stack_;
  BvhDocument document_;
};

}  // namespace

BvhDocument parse_bvh(std::string_view text, const BvhRowSink& sink, const BvhPassed& passed) {
  return Parser(text, sink, passed).run();
}

}  // namespace limber
