// Runs the engine-free part without Unreal: each line of the input is a command or a frame of the server, each line of the
// output a frame to send, an event, or numbers, up to "end".
#include "Arm.h"
#include "Stl.h"

#include <cstdio>
#include <fstream>
#include <iostream>
#include <iterator>
#include <limits>
#include <sstream>

namespace
{
void Print(const std::vector<Armbridge::FEvent>& Events)
{
	for (const Armbridge::FEvent& Event : Events)
	{
		switch (Event.Kind)
		{
		case Armbridge::FEvent::EKind::Joints:
			std::cout << "joints";
			for (const std::string& Name : Event.Names)
			{
				std::cout << " " << Name;
			}
			std::cout << std::endl;
			break;
		case Armbridge::FEvent::EKind::GoalEnded:
			std::cout << "goal " << Event.Code << " " << Event.Message << std::endl;
			break;
		case Armbridge::FEvent::EKind::GripperEnded:
			std::cout << "gripper " << Event.Code << " " << Event.Message << std::endl;
			break;
		case Armbridge::FEvent::EKind::Refused:
			std::cout << "refused " << Event.Message << std::endl;
			break;
		}
	}
}

void Print(const Armbridge::FRequest& Request)
{
	std::cout << (Request.Error.empty() ? "send " + Request.Frame : "error " + Request.Error) << std::endl;
}

void Print(const Armbridge::FTriple& Triple)
{
	std::printf("triple %.17g %.17g %.17g\n", Triple.X, Triple.Y, Triple.Z);
}

void Print(const Armbridge::FRotation& Rotation)
{
	std::printf("rotation %.17g %.17g %.17g %.17g\n", Rotation.X, Rotation.Y, Rotation.Z, Rotation.W);
}

double Number(std::istringstream& Words)
{
	std::string Word;
	Words >> Word;
	return Word == "nan" ? std::numeric_limits<double>::quiet_NaN() : std::stod(Word);
}
}

int main()
{
	Armbridge::FArm Arm;
	int64_t NowMs = 1700000000000;
	std::string Line;
	while (std::getline(std::cin, Line))
	{
		std::istringstream Words(Line);
		std::string Word;
		Words >> Word;
		if (Word == "setup")
		{
			std::string Token;
			Words >> Token;
			for (const std::string& Frame : Armbridge::FArm::Setup(Token))
			{
				std::cout << "send " << Frame << std::endl;
			}
		}
		else if (Word == "frame")
		{
			Print(Arm.Take(Line.substr(6)));
		}
		else if (Word == "lose")
		{
			Print(Arm.Lose());
		}
		else if (Word == "named")
		{
			Words >> Word;
			Print(Arm.MoveToNamed(Word));
		}
		else if (Word == "joint")
		{
			Words >> Word;
			Print(Arm.MoveJoints(++NowMs, {Word}, {Number(Words)}));
		}
		else if (Word == "tip")
		{
			const double X = Number(Words), Y = Number(Words), Z = Number(Words);
			Print(Arm.MoveTip(++NowMs, Armbridge::RosFromUnreal({X, Y, Z}), nullptr));
		}
		else if (Word == "gripper")
		{
			Print(Arm.MoveGripper(Number(Words), 0.0));
		}
		else if (Word == "stop")
		{
			std::cout << "send " << Armbridge::FArm::Stop() << std::endl;
		}
		else if (Word == "position" || Word == "position_back")
		{
			const double X = Number(Words), Y = Number(Words), Z = Number(Words);
			Print(Word == "position" ? Armbridge::RosFromUnreal({X, Y, Z}) : Armbridge::UnrealFromRos({X, Y, Z}));
		}
		else if (Word == "rotation")
		{
			const double X = Number(Words), Y = Number(Words), Z = Number(Words), W = Number(Words);
			Print(Armbridge::MirroredRotation({X, Y, Z, W}));
		}
		else if (Word == "rpy")
		{
			const double Roll = Number(Words), Pitch = Number(Words), Yaw = Number(Words);
			Print(Armbridge::FromRollPitchYaw(Roll, Pitch, Yaw));
		}
		else if (Word == "delays")
		{
			double DelayS = Armbridge::FirstDelayS;
			for (int Count = 0; Count < 7; ++Count, DelayS = Armbridge::NextDelay(DelayS))
			{
				std::printf("delay %g\n", DelayS);
			}
		}
		else if (Word == "stl")
		{
			Words >> Word;
			std::ifstream File(Word, std::ios::binary);
			const std::vector<uint8_t> Bytes((std::istreambuf_iterator<char>(File)), std::istreambuf_iterator<char>());
			std::vector<float> Corners;
			std::string Error;
			const bool bRead = Armbridge::ParseStl(Bytes, Corners, Error);
			std::cout << (bRead ? "corners " + std::to_string(Corners.size()) : "error " + Error) << std::endl;
		}
		std::fflush(stdout);
		std::cout << "end" << std::endl;
	}
}
