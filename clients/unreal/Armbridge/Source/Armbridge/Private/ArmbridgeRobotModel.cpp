#include "ArmbridgeRobotModel.h"

#include "Misc/Paths.h"
#include "XmlFile.h"

namespace
{
TArray<double> Numbers(const FXmlNode* Node, const TCHAR* Attribute)
{
	TArray<FString> Words;
	TArray<double> Values;
	if (Node)
	{
		Node->GetAttribute(Attribute).ParseIntoArrayWS(Words);
	}
	for (const FString& Word : Words)
	{
		Values.Add(FCString::Atod(*Word));
	}
	return Values;
}

Armbridge::FTriple Triple(const FXmlNode* Node, const TCHAR* Attribute, const Armbridge::FTriple& Missing)
{
	const TArray<double> Values = Numbers(Node, Attribute);
	return Values.Num() == 3 ? Armbridge::FTriple{Values[0], Values[1], Values[2]} : Missing;
}

Armbridge::FRotation Turned(const FXmlNode* Origin)
{
	const Armbridge::FTriple Angles = Triple(Origin, TEXT("rpy"), {});
	return Armbridge::FromRollPitchYaw(Angles.X, Angles.Y, Angles.Z);
}

double Number(const FXmlNode* Node, const TCHAR* Attribute)
{
	const TArray<double> Values = Numbers(Node, Attribute);
	return Values.Num() == 1 ? Values[0] : 0.0;
}

/** The server has the meshes of a package in the folder of its name, beside the URDF. */
FString MeshUrl(const FString& File, const FString& Url)
{
	FString Path = File;
	Path.RemoveFromStart(TEXT("package://"));
	return FPaths::GetPath(Url) / Path;
}

bool SetShape(FArmbridgeVisual& Visual, const FXmlNode* Geometry, const FString& Url)
{
	const FXmlNode* Shape = Geometry ? Geometry->GetFirstChildNode() : nullptr;
	const FString Tag = Shape ? Shape->GetTag() : FString();
	if (Tag == TEXT("box"))
	{
		Visual.Shape = EArmbridgeShape::Box;
		Visual.Size = Triple(Shape, TEXT("size"), {});
	}
	else if (Tag == TEXT("cylinder") || Tag == TEXT("sphere"))
	{
		const double Diameter = 2.0 * Number(Shape, TEXT("radius"));
		Visual.Shape = Tag == TEXT("sphere") ? EArmbridgeShape::Sphere : EArmbridgeShape::Cylinder;
		Visual.Size = {Diameter, Diameter, Tag == TEXT("sphere") ? Diameter : Number(Shape, TEXT("length"))};
	}
	else if (Tag == TEXT("mesh"))
	{
		Visual.Shape = EArmbridgeShape::Mesh;
		Visual.Mesh = MeshUrl(Shape->GetAttribute(TEXT("filename")), Url);
		Visual.Size = Triple(Shape, TEXT("scale"), {1.0, 1.0, 1.0});
	}
	else
	{
		return false;
	}
	return true;
}
}

bool FArmbridgeRobotModel::Parse(const FString& Urdf, const FString& Url, FString& Error)
{
	const FXmlFile File(Urdf, EConstructMethod::ConstructFromBuffer);
	if (!File.IsValid())
	{
		Error = File.GetLastError();
		return false;
	}
	TMap<FString, FLinearColor> Colors;
	for (const FXmlNode* Node : File.GetRootNode()->GetChildrenNodes())
	{
		const FString Name = Node->GetAttribute(TEXT("name"));
		if (Node->GetTag() == TEXT("material"))
		{
			const TArray<double> Color = Numbers(Node->FindChildNode(TEXT("color")), TEXT("rgba"));
			if (Color.Num() == 4)
			{
				Colors.Add(Name, FLinearColor(Color[0], Color[1], Color[2], Color[3]));
			}
		}
		else if (Node->GetTag() == TEXT("link"))
		{
			Links.Add(Name);
			for (const FXmlNode* Part : Node->GetChildrenNodes())
			{
				FArmbridgeVisual Visual;
				if (Part->GetTag() != TEXT("visual") || !SetShape(Visual, Part->FindChildNode(TEXT("geometry")), Url))
				{
					continue;
				}
				const FXmlNode* Origin = Part->FindChildNode(TEXT("origin"));
				const FXmlNode* Material = Part->FindChildNode(TEXT("material"));
				const FLinearColor* Color = Material ? Colors.Find(Material->GetAttribute(TEXT("name"))) : nullptr;
				Visual.Link = Name;
				Visual.Position = Triple(Origin, TEXT("xyz"), {});
				Visual.Rotation = Turned(Origin);
				Visual.Color = Color ? *Color : FLinearColor(0.8f, 0.8f, 0.8f, 1.0f);
				Visuals.Add(Visual);
			}
		}
		else if (Node->GetTag() == TEXT("joint"))
		{
			const FXmlNode* Parent = Node->FindChildNode(TEXT("parent"));
			const FXmlNode* Child = Node->FindChildNode(TEXT("child"));
			if (!Parent || !Child)
			{
				Error = TEXT("joint ") + Name + TEXT(" has no parent or no child");
				return false;
			}
			const FString Type = Node->GetAttribute(TEXT("type"));
			const FXmlNode* Origin = Node->FindChildNode(TEXT("origin"));
			FArmbridgeJoint Joint;
			Joint.Name = Name;
			Joint.Parent = Parent->GetAttribute(TEXT("link"));
			Joint.Child = Child->GetAttribute(TEXT("link"));
			Joint.bTurns = Type == TEXT("revolute") || Type == TEXT("continuous");
			Joint.bSlides = Type == TEXT("prismatic");
			Joint.Position = Triple(Origin, TEXT("xyz"), {});
			Joint.Rotation = Turned(Origin);
			Joint.Axis = Triple(Node->FindChildNode(TEXT("axis")), TEXT("xyz"), Joint.Axis);
			Joints.Add(Joint);
		}
	}
	return true;
}
